//! Pictures of parallax-mapped surfaces against displaced geometry, by the shipped passes on this
//! machine's GPU: silhouettes, lines of intersection, pixels that are not finite.

use crate::headless_renderer;
use crate::stats::quantile;
use client::camera::{Pose, Projection};
use client::features::pom::PomSettings;
use client::features::terrain_clipmap::window::STANDARD_TEXELS;
use client::frame::FrameData;
use client::gpu::{Gpu, GpuError, Image, OffscreenTarget, offscreen};
use client::renderer::{RenderOptions, Renderer};
use client::scene::Scene;
use client::scene::objects::{Mode, Object};
use client::settings::{RenderSettings, Show};
use client::stream::NullStream;
use client::stream::streamer::WorldStreamer;
use client::view::ViewParams;
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
pub struct PomRenderer {
    gpu: Gpu,
    renderer: Renderer,
    target: OffscreenTarget,
    scene: Scene,
    size: (u32, u32),
}

/// The linear light of a picture: RGBA as half floats, row by row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Light(pub Vec<[u16; 4]>);

impl Light {
    /// Pixels with a colour channel that is no finite number.
    pub fn unlit(&self) -> usize {
        // An exponent of all ones is infinite or no number.
        self.0.iter().filter(|pixel| pixel[..3].iter().any(|half| half & 0x7c00 == 0x7c00)).count()
    }

    /// Pixels that are not the same, bit for bit.
    pub fn differing(&self, other: &Self) -> Mask {
        Mask(self.0.iter().zip(&other.0).map(|(one, other)| one != other).collect())
    }
}

/// Pixels that something is true of, row by row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask(pub Vec<bool>);

impl Mask {
    /// How many.
    pub fn count(&self) -> usize {
        self.0.iter().filter(|is| **is).count()
    }

    /// Intersection over union; no number for two empty ones, which compare nothing.
    pub fn overlap(&self, other: &Self) -> f64 {
        let both = self.0.iter().zip(&other.0).filter(|(one, other)| **one && **other).count();
        let any = self.0.iter().zip(&other.0).filter(|(one, other)| **one || **other).count();
        both as f64 / any as f64
    }
}

impl PomRenderer {
    /// Opens the best adapter for pictures of a size in pixels, with the procedural materials.
    pub fn open(scene: Scene, size: (u32, u32)) -> Result<Self, GpuError> {
        Self::filtered(scene, size, 1)
    }

    /// The same with an anisotropy of the filter of materials, 1 to 16.
    pub fn filtered(scene: Scene, size: (u32, u32), anisotropy: u16) -> Result<Self, GpuError> {
        let gpu = Gpu::open_blocking()?;
        let options = RenderOptions {
            scene,
            size,
            samples: 1,
            anisotropy,
            format: offscreen::IMAGE_FORMAT,
            slots: 1,
            clipmap_texels: STANDARD_TEXELS,
        };
        let renderer = Renderer::new(&gpu, &options);
        let target = OffscreenTarget::new(&gpu.device, size.0, size.1);
        Ok(Self { gpu, renderer, target, scene, size })
    }

    /// Puts other objects into the scene.
    pub fn set_objects(&mut self, objects: Vec<Object>) {
        self.renderer.set_objects(&self.gpu, objects);
    }

    /// The frame of a pose, by looks.
    pub fn frame(&self, pose: Pose, settings: RenderSettings) -> FrameData {
        let shot = ViewParams {
            pose,
            projection: Projection { fov_deg: 40.0, width: self.size.0, height: self.size.1 },
            view_distance_m: 1000,
            tolerance_px: 2.0,
            time_s: 0.0,
            settings,
        };
        let mut streamer = WorldStreamer::new(NullStream, 1);
        let selection = streamer.update(&shot, Duration::ZERO, usize::MAX, |_| {});
        shot.frame(self.scene, streamer.cache(), &selection)
    }

    /// Draws a frame; returns the time until the GPU is done.
    pub fn draw(&mut self, frame: &FrameData) -> Result<Duration, GpuError> {
        headless_renderer::draw(&self.gpu, &mut self.renderer, frame, &self.target)
    }

    /// Name and backend of the adapter, for people.
    pub fn adapter(&self) -> String {
        self.gpu.name()
    }

    /// Draws a frame and brings its light back.
    pub fn light(&mut self, frame: &FrameData) -> Result<Light, GpuError> {
        let halves = self.renderer.read_hdr(&self.gpu, frame, &self.target)?.expect("one sample a pixel");
        Ok(Light(halves.chunks_exact(4).map(|pixel| [pixel[0], pixel[1], pixel[2], pixel[3]]).collect()))
    }

    /// The light of objects by a pose and knobs.
    pub fn shown(
        &mut self,
        objects: &[Object],
        pose: Pose,
        pom: PomSettings,
        show: Show,
    ) -> Result<Light, GpuError> {
        self.set_objects(objects.to_vec());
        self.light(&self.frame(pose, RenderSettings { pom, show, ..RenderSettings::default() }))
    }

    /// The picture of the last frame.
    pub fn picture(&self) -> Result<Image, GpuError> {
        self.target.read(&self.gpu)
    }

    /// Pixels that objects cover.
    pub fn cover(&mut self, objects: &[Object], pose: Pose, relief: PomSettings) -> Result<Mask, GpuError> {
        let nothing = self.shown(&[], pose, relief, Show::Image)?;
        Ok(self.shown(objects, pose, relief, Show::Image)?.differing(&nothing))
    }

    /// Where a ball is cut by what it is sunk into, as pixels of the picture: those of the ball
    /// next to ones that it would cover if it stood alone.
    pub fn cut_line(
        &mut self,
        relief: &Object,
        ball: &Object,
        pose: Pose,
        knobs: PomSettings,
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
pub fn silhouette_overlap(
    renderer: &mut PomRenderer,
    mode: Mode,
    knobs: PomSettings,
    elevation_deg: f64,
) -> Result<f64, GpuError> {
    let mut worst = 1.0f64;
    for bearing_deg in BEARINGS_DEG {
        let pose = around(elevation_deg, bearing_deg, 4.2);
        let reference = renderer.cover(&[plane(Mode::Geometry)], pose, knobs)?;
        worst = worst.min(renderer.cover(&[plane(mode)], pose, knobs)?.overlap(&reference));
    }
    Ok(worst)
}

/// How far the line in which the ball is cut by the marched plane is from the one in which
/// displaced geometry cuts it: the distance in pixels that 99 % of both lines keep, and the length
/// of the true line. Infinite if either is not there.
pub fn cut_distance(
    renderer: &mut PomRenderer,
    knobs: PomSettings,
    elevation_deg: f64,
) -> Result<(f64, usize), GpuError> {
    let pose = around(elevation_deg, 25.0, 2.6);
    let reference = renderer.cut_line(&plane(Mode::Geometry), &ball(), pose, knobs)?;
    let own = renderer.cut_line(&plane(Mode::Settings), &ball(), pose, knobs)?;
    Ok((quantile(&line_distances(&own, &reference), 0.99), reference.len()))
}

/// The plane under measurement.
pub fn plane(mode: Mode) -> Object {
    Object { relief_m: RELIEF_M, ..Object::ground(mode, DVec3::ZERO, SIDE_M, TILE_M) }
}

/// A ball sunk into it to the middle.
pub fn ball() -> Object {
    Object::ball(DVec3::ZERO, 0.6, Vec3::splat(0.5))
}

/// A camera on a circle around the plane: degrees above it, degrees around.
pub fn around(elevation_deg: f64, bearing_deg: f64, distance_m: f64) -> Pose {
    let (elevation, yaw) = (elevation_deg.to_radians(), bearing_deg.to_radians());
    let back = DVec3::new(-yaw.sin() * elevation.cos(), elevation.sin(), yaw.cos() * elevation.cos());
    Pose { position_m: back * distance_m, yaw_deg: bearing_deg, pitch_deg: -elevation_deg }
}

/// Distance of each pixel of either line to the nearest one of the other, pixels, in ascending
/// order; infinite if a line is empty.
pub fn line_distances(one: &[(i32, i32)], other: &[(i32, i32)]) -> Vec<f64> {
    let nearest = |from: &(i32, i32), line: &[(i32, i32)]| {
        let squares = line.iter().map(|to| (to.0 - from.0).pow(2) + (to.1 - from.1).pow(2));
        squares.min().map_or(f64::INFINITY, |square| f64::from(square).sqrt())
    };
    let mut distances: Vec<f64> = one.iter().map(|from| nearest(from, other)).collect();
    distances.extend(other.iter().map(|from| nearest(from, one)));
    if distances.is_empty() {
        distances.push(f64::INFINITY);
    }
    distances.sort_by(f64::total_cmp);
    distances
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlap_and_line_distances_are_those_of_known_masks() {
        let mask = |bits: [bool; 4]| Mask(bits.to_vec());
        let (left, all) = (mask([true, true, false, false]), mask([true; 4]));
        assert_eq!((left.overlap(&all), left.overlap(&left), left.count()), (0.5, 1.0, 2));
        assert_eq!(line_distances(&[(0, 0)], &[(3, 4), (0, 1)]), [1.0, 1.0, 5.0]);
        assert_eq!(line_distances(&[(0, 0)], &[]), [f64::INFINITY]);
        assert_eq!(line_distances(&[], &[]), [f64::INFINITY]);
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
