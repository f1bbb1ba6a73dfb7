//! How much shading changes when the tolerance grows: mean FLIP of the ground between pictures of
//! 0.5 and 4 px.

use super::views::{Shot, Views, is_one_surface};
use crate::flip::{self, PIXELS_PER_DEGREE};
use client::gpu::GpuError;
use client::settings::{Normals, Show};
use serde::Serialize;

/// The tolerances, pixels.
const TOLERANCES_PX: [f64; 2] = [0.5, 4.0];

/// Mean FLIP over the ground of all poses.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Tolerance {
    /// Normals of the land.
    pub land: f64,
    /// Normals of the drawn triangles: the control.
    pub mesh: f64,
    /// Normals of the land, light on white ground: without the materials, which move with the
    /// drawn surface.
    pub land_light: f64,
    /// The same by normals of the drawn triangles.
    pub mesh_light: f64,
}

/// Measures all poses.
pub fn measure(views: &mut Views) -> Result<Tolerance, GpuError> {
    let shot = |normals, show| Shot { normals, show, ..Shot::IMAGE };
    Ok(Tolerance {
        land: change(views, shot(Normals::Land, Show::Image))?,
        mesh: change(views, shot(Normals::Mesh, Show::Image))?,
        land_light: change(views, shot(Normals::Land, Show::Light))?,
        mesh_light: change(views, shot(Normals::Mesh, Show::Light))?,
    })
}

fn change(views: &mut Views, shot: Shot) -> Result<f64, GpuError> {
    let (mut sum, mut pixels) = (0.0, 0_usize);
    for case in views.cases.clone() {
        let shots = TOLERANCES_PX.map(|tolerance_px| Shot { tolerance_px, ..shot });
        // Pixels whose surface stays: outlines change with the triangles, not with the shading.
        let mut grounds = Vec::new();
        let mut pictures = Vec::new();
        for shot in shots {
            grounds.push(views.light(&case, Shot { show: Show::Chunks, ..shot })?);
            pictures.push(views.image(&case, shot)?);
        }
        let map = flip::map(&pictures[0], &pictures[1], PIXELS_PER_DEGREE);
        for (pixel, flip) in map.into_iter().enumerate() {
            let [fine, coarse] = [0, 1].map(|index: usize| -grounds[index][pixel][3]);
            if is_one_surface(fine, coarse) {
                sum += flip;
                pixels += 1;
            }
        }
    }
    Ok(sum / pixels.max(1) as f64)
}
