//! What pictures of reliefs say: where their edge is, where objects are sunk into them, whether
//! every pixel is a number. Against displaced geometry, by the shipped passes on this machine's
//! GPU.

use client::camera::{Lens, Pose};
use client::feed::NoFeed;
use client::frame::{FrameData, Shot};
use client::looks::{Looks, Show};
use client::relief::ReliefKnobs;
use client::render::materials::OwnMaterials;
use client::render::scenes::relief::objects::{Mode, Object};
use client::render::{Canvas, Gpu, GpuError, Picture, RenderOptions, Renderer, gpu, picture};
use client::scene::Scene;
use client::voyage::Voyage;
use glam::{DVec3, Vec3};
use std::time::Duration;

/// Metres from height 0 to height 1 of the plane under measurement.
pub const RELIEF_M: f32 = 0.10;
/// Its side: half a tile, so that displaced geometry has a vertex for every texel.
pub const SIDE_M: f32 = 2.5;
/// Tile of its material, metres.
pub const TILE_M: f32 = 5.0;

/// A renderer of a scene of reliefs whose objects can be exchanged; one sample per pixel.
#[derive(Debug)]
pub struct ReliefStudio {
    gpu: Gpu,
    renderer: Renderer,
    canvas: Canvas,
    scene: Scene,
    size: (u32, u32),
}

/// The linear light of a picture: RGBA as half floats, row by row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Light(pub Vec<[u16; 4]>);

impl Light {
    /// Pixels with a colour channel that is no finite number.
    #[must_use]
    pub fn unlit(&self) -> usize {
        // An exponent of all ones is infinite or no number.
        self.0.iter().filter(|pixel| pixel[..3].iter().any(|half| half & 0x7c00 == 0x7c00)).count()
    }

    /// Pixels that are not the same, bit for bit.
    #[must_use]
    pub fn differing(&self, other: &Self) -> Mask {
        Mask(self.0.iter().zip(&other.0).map(|(one, other)| one != other).collect())
    }
}

/// Pixels that something is true of, row by row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask(pub Vec<bool>);

impl Mask {
    /// How many.
    #[must_use]
    pub fn count(&self) -> usize {
        self.0.iter().filter(|is| **is).count()
    }

    /// Intersection over union; 1 of two empty ones.
    #[must_use]
    pub fn overlap(&self, other: &Self) -> f64 {
        let both = self.0.iter().zip(&other.0).filter(|(one, other)| **one && **other).count();
        let any = self.0.iter().zip(&other.0).filter(|(one, other)| **one || **other).count();
        if any == 0 { 1.0 } else { both as f64 / any as f64 }
    }
}

impl ReliefStudio {
    /// Opens the best adapter for pictures of a size in pixels, with the procedural materials.
    ///
    /// # Errors
    /// There is no adapter, or it cannot be opened.
    pub fn open(scene: Scene, size: (u32, u32)) -> Result<Self, GpuError> {
        Self::furnished(scene, size, &OwnMaterials::default())
    }

    /// The same with own materials.
    ///
    /// # Errors
    /// As [`ReliefStudio::open`].
    pub fn furnished(scene: Scene, size: (u32, u32), own: &OwnMaterials) -> Result<Self, GpuError> {
        let gpu = pollster::block_on(Gpu::open(gpu::instance(None), None))?;
        let options = RenderOptions { scene, size, samples: 1, format: picture::PICTURE_FORMAT, slots: 1 };
        let renderer = Renderer::with_materials(&gpu, &options, own);
        let canvas = Canvas::new(&gpu.device, size.0, size.1);
        Ok(Self { gpu, renderer, canvas, scene, size })
    }

    /// Puts other objects into the scene.
    pub fn arrange(&mut self, objects: Vec<Object>) {
        self.renderer.arrange(&self.gpu, objects);
    }

    /// The frame of a pose, by looks.
    #[must_use]
    pub fn frame(&self, pose: Pose, looks: Looks) -> FrameData {
        let shot = Shot {
            pose,
            lens: Lens { fov_deg: 40.0, width: self.size.0, height: self.size.1 },
            view_distance_m: 1000,
            tolerance_px: 2.0,
            time_s: 0.0,
            looks,
        };
        let mut voyage = Voyage::new(NoFeed, 1);
        let selection = voyage.update(&shot, Duration::ZERO, usize::MAX, |_| {});
        shot.frame(self.scene, voyage.world(), &selection)
    }

    /// Draws a frame and brings its light back.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn light(&mut self, frame: &FrameData) -> Result<Light, GpuError> {
        let halves = self.renderer.light(&self.gpu, frame, &self.canvas)?.unwrap_or_default();
        Ok(Light(halves.chunks_exact(4).map(|pixel| [pixel[0], pixel[1], pixel[2], pixel[3]]).collect()))
    }

    /// The light of objects by a pose and knobs.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn shown(
        &mut self,
        objects: &[Object],
        pose: Pose,
        relief: ReliefKnobs,
        show: Show,
    ) -> Result<Light, GpuError> {
        self.arrange(objects.to_vec());
        self.light(&self.frame(pose, Looks { relief, show, ..Looks::default() }))
    }

    /// The picture of the last frame.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn picture(&self) -> Result<Picture, GpuError> {
        self.canvas.read(&self.gpu)
    }

    /// Pixels that objects cover.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn cover(&mut self, objects: &[Object], pose: Pose, relief: ReliefKnobs) -> Result<Mask, GpuError> {
        let nothing = self.shown(&[], pose, relief, Show::Picture)?;
        Ok(self.shown(objects, pose, relief, Show::Picture)?.differing(&nothing))
    }

    /// Where a ball is cut by what it is sunk into, as pixels of the picture: those of the ball
    /// next to ones that it would cover if it stood alone.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn cut_line(
        &mut self,
        relief: &Object,
        ball: &Object,
        pose: Pose,
        knobs: ReliefKnobs,
    ) -> Result<Vec<(i32, i32)>, GpuError> {
        // Normals do not depend on shadows, so the ball has the same light in both pictures.
        let nothing = self.shown(&[], pose, knobs, Show::Normals)?;
        let alone = self.shown(std::slice::from_ref(ball), pose, knobs, Show::Normals)?;
        let both = self.shown(&[*relief, *ball], pose, knobs, Show::Normals)?;
        let whole = alone.differing(&nothing);
        let hidden = both.differing(&alone);
        let (width, height) = (self.size.0 as i32, self.size.1 as i32);
        let at = |mask: &Mask, x: i32, y: i32| {
            (0..width).contains(&x) && (0..height).contains(&y) && mask.0[(y * width + x) as usize]
        };
        let is_line = |x: i32, y: i32| {
            let beside = [(1, 0), (-1, 0), (0, 1), (0, -1)];
            at(&whole, x, y)
                && !at(&hidden, x, y)
                && beside.iter().any(|(dx, dy)| at(&whole, x + dx, y + dy) && at(&hidden, x + dx, y + dy))
        };
        Ok((0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .filter(|(x, y)| is_line(*x, *y))
            .collect())
    }
}

/// Bearings from which silhouettes are compared, degrees.
pub const BEARINGS_DEG: [f64; 3] = [0.0, 30.0, 77.0];

/// How well what the plane covers in some mode agrees with what displaced geometry covers: the
/// least intersection over union of all bearings, at an elevation of the camera.
///
/// # Errors
/// The GPU failed.
pub fn silhouette_overlap(
    studio: &mut ReliefStudio,
    mode: Mode,
    knobs: ReliefKnobs,
    elevation_deg: f64,
) -> Result<f64, GpuError> {
    let mut worst = 1.0f64;
    for bearing_deg in BEARINGS_DEG {
        let pose = around(elevation_deg, bearing_deg, 4.2);
        let truth = studio.cover(&[plane(Mode::Geometry)], pose, knobs)?;
        worst = worst.min(studio.cover(&[plane(mode)], pose, knobs)?.overlap(&truth));
    }
    Ok(worst)
}

/// How far the line in which the ball is cut by the marched plane is from the one in which
/// displaced geometry cuts it: the distance in pixels that 99 % of both lines keep, and the length
/// of the true line. Infinite if either is not there.
///
/// # Errors
/// The GPU failed.
pub fn cut_distance(
    studio: &mut ReliefStudio,
    knobs: ReliefKnobs,
    elevation_deg: f64,
) -> Result<(f64, usize), GpuError> {
    let pose = around(elevation_deg, 25.0, 2.6);
    let truth = studio.cut_line(&plane(Mode::Geometry), &ball(), pose, knobs)?;
    let own = studio.cut_line(&plane(Mode::Knobs), &ball(), pose, knobs)?;
    Ok((quantile(&line_distances(&own, &truth), 0.99), truth.len()))
}

/// The plane under measurement.
#[must_use]
pub fn plane(mode: Mode) -> Object {
    Object { relief_m: RELIEF_M, ..Object::ground(mode, DVec3::ZERO, SIDE_M, TILE_M) }
}

/// A ball sunk into it to the middle.
#[must_use]
pub fn ball() -> Object {
    Object::ball(DVec3::ZERO, 0.6, Vec3::splat(0.5))
}

/// A camera on a circle around the plane: degrees above it, degrees around.
#[must_use]
pub fn around(elevation_deg: f64, bearing_deg: f64, distance_m: f64) -> Pose {
    let (elevation, yaw) = (elevation_deg.to_radians(), bearing_deg.to_radians());
    let back = DVec3::new(-yaw.sin() * elevation.cos(), elevation.sin(), yaw.cos() * elevation.cos());
    Pose { position_m: back * distance_m, yaw_deg: bearing_deg, pitch_deg: -elevation_deg }
}

/// Distance of each pixel of either line to the nearest one of the other, pixels, in ascending
/// order; infinite if one line is empty.
#[must_use]
pub fn line_distances(one: &[(i32, i32)], other: &[(i32, i32)]) -> Vec<f64> {
    let nearest = |from: &(i32, i32), line: &[(i32, i32)]| {
        let squares = line.iter().map(|to| (to.0 - from.0).pow(2) + (to.1 - from.1).pow(2));
        squares.min().map_or(f64::INFINITY, |square| f64::from(square).sqrt())
    };
    let mut distances: Vec<f64> = one.iter().map(|from| nearest(from, other)).collect();
    distances.extend(other.iter().map(|from| nearest(from, one)));
    distances.sort_by(f64::total_cmp);
    distances
}

/// The value below which a share of sorted values lies; infinite of none.
#[must_use]
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let index = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(index.clamp(1, sorted.len().max(1)) - 1).copied().unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_lines_and_quantiles_say_what_is_the_case() {
        let mask = |bits: [bool; 4]| Mask(bits.to_vec());
        let (left, all) = (mask([true, true, false, false]), mask([true; 4]));
        assert_eq!((left.overlap(&all), left.overlap(&left), left.count()), (0.5, 1.0, 2));
        assert_eq!(line_distances(&[(0, 0)], &[(3, 4), (0, 1)]), [1.0, 1.0, 5.0]);
        assert_eq!(line_distances(&[(0, 0)], &[]), [f64::INFINITY]);
        let values: Vec<f64> = (1..=100).map(f64::from).collect();
        assert_eq!(
            (quantile(&values, 0.99), quantile(&values, 0.0), quantile(&[], 0.5)),
            (99.0, 1.0, f64::INFINITY)
        );
        let light = Light(vec![[0, 0, 0x3c00, 0x7c00], [0x7e00, 0, 0, 0]]);
        assert_eq!(light.unlit(), 1);
    }

    #[test]
    fn a_camera_around_the_plane_looks_at_its_middle() {
        for (elevation, bearing) in [(16.0, 0.0), (5.0, 70.0), (89.0, 200.0)] {
            let pose = around(elevation, bearing, 4.0);
            assert!((pose.position_m + pose.forward() * 4.0).length() < 1e-9, "{elevation} {bearing}");
        }
    }
}
