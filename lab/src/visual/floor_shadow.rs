//! Shadows of objects on the floor of the parallax scenes against a truth in f64.
//!
//! The share of the sun at a pixel of the floor follows from three pictures: of the scene, of the
//! floor alone, and of the floor with the sun blocked.

use crate::pom::renderer::{Light, PomRenderer};
use client::camera::{Pose, Projection};
use client::features::pom::PomSettings;
use client::gpu::GpuError;
use client::scene::Scene;
use client::scene::objects::{self, Mode, Object, Shape};
use client::settings::Show;
use glam::{DQuat, DVec3};
use half::f16;
use serde::Serialize;

/// Picture size, pixels.
const SIZE: (u32, u32) = (320, 180);

/// Poses of each scene. The first of `spom` is one from which the shadows lay 0.3 m off where
/// places on the floor were interpolated over its triangles.
const POSES: [(Scene, &str); 6] = [
    (Scene::Spom, "1.5,2.1,4.3,10,-15"),
    (Scene::Spom, "-2.4,1.6,4.0,35,-18"),
    (Scene::Spom, "0,3.5,5.5,0,-32"),
    (Scene::Pom, "-9,3.2,6,40,-20"),
    (Scene::Pom, "9,2.6,7,-40,-16"),
    (Scene::Pom, "0,4.5,10,0,-25"),
];

/// Share of the sun, 0 to 1, by which a pixel must differ from the truth to be wrong.
const WRONG: f64 = 0.25;

/// Farthest place of the floor that counts, metres.
const FARTHEST_M: f64 = 40.0;

/// Metres by which the control moves the truth.
const CONTROL_M: f64 = 0.3;

/// The figures.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct FloorShadow {
    /// Pixels of the floor.
    pub pixels: usize,
    /// Those of them in shadow by the truth.
    pub shaded: usize,
    /// Pixels that are wrong.
    pub wrong: usize,
    /// Pixels that are wrong if the truth is moved by 0.3 m: the control.
    pub control: usize,
}

/// Measures all poses.
pub fn measure() -> Result<FloorShadow, GpuError> {
    let mut sum = FloorShadow::default();
    for scene in [Scene::Spom, Scene::Pom] {
        let mut renderer = PomRenderer::open(scene, SIZE)?;
        for (_, camera) in POSES.iter().filter(|(of, _)| *of == scene) {
            let pose: Pose = camera.parse().expect("the poses of this module");
            add(&mut renderer, scene, pose, &mut sum)?;
        }
    }
    Ok(sum)
}

fn add(renderer: &mut PomRenderer, scene: Scene, pose: Pose, sum: &mut FloorShadow) -> Result<(), GpuError> {
    let all = objects::of(scene);
    let is_floor = |object: &&Object| is_floor(object);
    let floor: Vec<Object> = all.iter().filter(is_floor).copied().collect();
    let others: Vec<Object> = all.iter().filter(|object| !is_floor(object)).copied().collect();
    let pom = PomSettings::default();
    let sun = sun_of(renderer, pose);
    let blocker =
        Object { shape: Shape::Cube { half_m: 200.0 }, ..Object::ball(600.0 * sun, 1.0, glam::Vec3::ZERO) };
    let covered = renderer.cover(&others, pose, pom)?;
    let drawn = renderer.shown(&all, pose, pom, Show::Image)?;
    let lit = renderer.shown(&floor, pose, pom, Show::Image)?;
    let blocked: Vec<Object> = floor.iter().copied().chain([blocker]).collect();
    let dark = renderer.shown(&blocked, pose, pom, Show::Image)?;
    let [drawn, lit, dark] = [drawn, lit, dark].map(|light| luminances(&light));
    let height_m = floor.first().map_or(0.0, |floor| floor.position_m.y);
    for (pixel, covered) in covered.0.iter().enumerate() {
        let Some(at_m) = on_floor(&pose, pixel, height_m).filter(|_| !covered) else { continue };
        let share = (drawn[pixel] - dark[pixel]) / (lit[pixel] - dark[pixel]);
        if !share.is_finite() {
            continue;
        }
        let truth = |at_m| others.iter().map(|object| sun_share(object, at_m, sun)).fold(1.0, f64::min);
        sum.pixels += 1;
        sum.shaded += usize::from(truth(at_m) < 0.5);
        sum.wrong += usize::from((share - truth(at_m)).abs() > WRONG);
        sum.control += usize::from((share - truth(at_m + CONTROL_M * DVec3::X)).abs() > WRONG);
    }
    Ok(())
}

fn is_floor(object: &Object) -> bool {
    object.mode == Mode::Plain && matches!(object.shape, Shape::Plane { .. })
}

fn sun_of(renderer: &PomRenderer, pose: Pose) -> DVec3 {
    let frame = renderer.frame(pose, client::settings::RenderSettings::default());
    glam::Vec3::from(frame.uniforms.sun).as_dvec3().normalize()
}

fn luminances(light: &Light) -> Vec<f64> {
    let sum = |pixel: &[u16; 4]| pixel[..3].iter().map(|bits| f16::from_bits(*bits).to_f64()).sum();
    light.0.iter().map(sum).collect()
}

/// Where the ray of a pixel meets the floor, metres.
fn on_floor(pose: &Pose, pixel: usize, height_m: f64) -> Option<DVec3> {
    let projection = Projection { fov_deg: 40.0, width: SIZE.0, height: SIZE.1 };
    let at = |index: usize, count: u32| (index as f64 + 0.5) / f64::from(count) * 2.0 - 1.0;
    let (x, y) = (at(pixel % SIZE.0 as usize, SIZE.0), -at(pixel / SIZE.0 as usize, SIZE.1));
    let half = projection.half_height();
    let ray = pose.forward() + pose.right() * (x * half * projection.aspect()) + pose.up() * (y * half);
    let way = (height_m - pose.position_m.y) / ray.y;
    (way > 0.0 && way * ray.length() < FARTHEST_M).then(|| pose.position_m + ray * way)
}

/// Share of the sun that an object leaves at a place: the rules of `pom_object_shadow.wesl`.
fn sun_share(object: &Object, at_m: DVec3, sun: DVec3) -> f64 {
    let turn: DQuat = object.turn.as_dquat().conjugate();
    let from_m = turn * (at_m - object.position_m);
    let to_sun = turn * sun;
    let half = match object.shape {
        Shape::Capsule { radius_m, half_length_m } => {
            return capsule_sun_share(from_m, to_sun, [radius_m, half_length_m].map(f64::from));
        }
        Shape::Plane { width_m, height_m } => {
            DVec3::new(0.5 * f64::from(width_m), 0.5 * f64::from(height_m), 0.02)
        }
        Shape::Cube { half_m } => DVec3::splat(f64::from(half_m)),
    };
    let ways = -from_m / to_sun;
    let spans = (half / to_sun).abs();
    let (enter, leave) = ((ways - spans).max_element(), (ways + spans).min_element());
    if enter < leave && leave > 0.0 && enter > 1e-3 { 0.0 } else { 1.0 }
}

fn capsule_sun_share(from_m: DVec3, sun: DVec3, [radius_m, half_length_m]: [f64; 2]) -> f64 {
    let across = (1.0 - sun.z * sun.z).max(1e-4);
    let reach = ((from_m.z - sun.z * from_m.dot(sun)) / across).clamp(-half_length_m, half_length_m);
    let to_axis = DVec3::new(0.0, 0.0, reach) - from_m;
    let along = to_axis.dot(sun);
    if along <= 0.0 {
        return 1.0;
    }
    let gap = (to_axis - sun * along).length() - radius_m;
    let part = ((gap / along.max(0.1) + 0.006) / 0.012).clamp(0.0, 1.0);
    part * part * (3.0 - 2.0 * part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ball_shades_what_lies_behind_it_and_nothing_else() {
        let ball = Object::ball(DVec3::new(0.0, 2.0, 0.0), 0.5, glam::Vec3::ZERO);
        let up = DVec3::Y;
        assert_eq!(sun_share(&ball, DVec3::ZERO, up), 0.0);
        assert_eq!(sun_share(&ball, DVec3::new(0.6, 0.0, 0.0), up), 1.0);
        assert_eq!(sun_share(&ball, DVec3::new(0.0, 4.0, 0.0), up), 1.0);
        let edge = sun_share(&ball, DVec3::new(0.5, 0.0, 0.0), up);
        assert!((0.3..0.7).contains(&edge), "{edge}");
    }

    #[test]
    fn the_middle_of_a_picture_meets_the_floor_in_front_of_the_eye() {
        let pose: Pose = "0,2,0,0,-45".parse().unwrap();
        let middle = (SIZE.1 / 2 * SIZE.0 + SIZE.0 / 2) as usize;
        let at_m = on_floor(&pose, middle, 0.0).unwrap();
        assert!((at_m - DVec3::new(0.0, 0.0, -2.0)).length() < 0.05, "{at_m}");
        assert!(on_floor(&Pose { pitch_deg: 30.0, ..pose }, 0, 0.0).is_none(), "the sky");
    }
}
