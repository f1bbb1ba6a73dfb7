//! View-frustum culling of chunks on the CPU.

use crate::cache::Resident;
use crate::camera::{Eye, Pose, Projection};
use glam::DVec3;

/// The four side planes of the view, through the eye.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frustum {
    /// Inward normals, world axes.
    normals: [DVec3; 4],
}

impl Frustum {
    /// The frustum of a camera.
    #[must_use]
    pub fn new(pose: &Pose, projection: &Projection) -> Self {
        let (forward, right, up) = (pose.forward(), pose.right(), pose.up());
        let height = projection.half_height();
        let width = height * projection.aspect();
        Self {
            normals: [
                right + forward * width,
                forward * width - right,
                up + forward * height,
                forward * height - up,
            ],
        }
    }

    /// Inward normals of the side planes, world axes, not normalized.
    #[must_use]
    pub fn normals(&self) -> &[DVec3; 4] {
        &self.normals
    }

    /// Whether the bounding box of a square part of a chunk may intersect the frustum.
    /// Conservative: true in doubt.
    ///
    /// The box holds the parent's extremes too: a morphed vertex lies between the two surfaces.
    #[must_use]
    pub fn may_intersect(
        &self,
        eye: &Eye,
        (x, z): (i32, i32),
        side: u32,
        chunk: &Resident,
        parent: &Resident,
    ) -> bool {
        let side = i64::from(side);
        let low = [i64::from(x), i64::from(chunk.min.min(parent.min)), i64::from(z)];
        let high = [i64::from(x) + side, i64::from(chunk.max.max(parent.max)), i64::from(z) + side];
        let relative = |corner: [i64; 3]| {
            // One unit of slack covers the eye's fraction.
            DVec3::from_array([0, 1, 2].map(|axis| (corner[axis] - i64::from(eye.units[axis])) as f64))
        };
        self.may_hold(relative(low) - DVec3::ONE, relative(high) + DVec3::ONE)
    }

    /// Whether a box may intersect the frustum; its corners from the eye, in any unit.
    /// Conservative: true in doubt.
    #[must_use]
    pub fn may_hold(&self, low: DVec3, high: DVec3) -> bool {
        self.normals.iter().all(|normal| {
            let farthest = DVec3::select(normal.cmpgt(DVec3::ZERO), high, low);
            normal.dot(farthest) >= 0.0
        })
    }
}
