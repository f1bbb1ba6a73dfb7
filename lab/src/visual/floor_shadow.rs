//! Shadows of objects on the floor of the parallax scenes against rays in f64 over the sun's disc.
//!
//! The share of the sun at a pixel of the floor follows from three pictures: of the scene, of the
//! floor alone, and of the floor with the sun blocked. The rays meet the shapes of the objects
//! without their reliefs; nothing of them is a rule of the shader, whose planes and cubes have hard
//! shadows and whose capsules have soft edges of a fixed width.

use crate::pom::renderer::{Light, PomRenderer};
use client::camera::{Pose, Projection};
use client::features::pom::PomSettings;
use client::gpu::GpuError;
use client::scene::Scene;
use client::scene::objects::{self, Mode, Object, Shape};
use client::settings::Show;
use glam::{DQuat, DVec3};
use half::f16;
use rayon::prelude::*;
use serde::Serialize;
use shaders::layout::SUN_RADIUS;

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

/// Rays over the sun's disc.
const RAYS: u32 = 61;

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

impl FloorShadow {
    /// The sums of both.
    const fn with(self, other: Self) -> Self {
        Self {
            pixels: self.pixels + other.pixels,
            shaded: self.shaded + other.shaded,
            wrong: self.wrong + other.wrong,
            control: self.control + other.control,
        }
    }
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
    let rays = rays_to(sun);
    let blocker =
        Object { shape: Shape::Cube { half_m: 200.0 }, ..Object::ball(600.0 * sun, 1.0, glam::Vec3::ZERO) };
    let covered = renderer.cover(&others, pose, pom)?;
    let drawn = renderer.shown(&all, pose, pom, Show::Image)?;
    let lit = renderer.shown(&floor, pose, pom, Show::Image)?;
    let blocked: Vec<Object> = floor.iter().copied().chain([blocker]).collect();
    let dark = renderer.shown(&blocked, pose, pom, Show::Image)?;
    let [drawn, lit, dark] = [drawn, lit, dark].map(|light| luminances(&light));
    let height_m = floor.first().map_or(0.0, |floor| floor.position_m.y);
    let pixels = covered.0.par_iter().enumerate().filter(|(_, covered)| !**covered);
    let found = pixels.filter_map(|(pixel, _)| {
        let at_m = on_floor(&pose, pixel, height_m)?;
        let share = (drawn[pixel] - dark[pixel]) / (lit[pixel] - dark[pixel]);
        let truth = sun_share(&others, at_m, &rays);
        let moved = sun_share(&others, at_m + CONTROL_M * DVec3::X, &rays);
        share.is_finite().then(|| FloorShadow {
            pixels: 1,
            shaded: usize::from(truth < 0.5),
            wrong: usize::from((share - truth).abs() > WRONG),
            control: usize::from((share - moved).abs() > WRONG),
        })
    });
    let found = found.reduce(FloorShadow::default, FloorShadow::with);
    *sum = sum.with(found);
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
    let distance = (height_m - pose.position_m.y) / ray.y;
    (distance > 0.0 && distance * ray.length() < FARTHEST_M).then(|| pose.position_m + ray * distance)
}

/// Unit vectors to places that are spread evenly over the sun's disc (H. Vogel, "A better way to
/// construct the sunflower head", 1979).
fn rays_to(sun: DVec3) -> Vec<DVec3> {
    let side = sun.any_orthonormal_vector();
    let above = sun.cross(side);
    let rays = (0..RAYS).map(|ray| {
        let out = ((f64::from(ray) + 0.5) / f64::from(RAYS)).sqrt() * SUN_RADIUS;
        let (sin, cos) = (2.399_963 * f64::from(ray)).sin_cos();
        (sun + out * (cos * side + sin * above)).normalize()
    });
    rays.collect()
}

/// Share of the sun that objects leave at a place: of the rays to it those that meet none of them.
fn sun_share(objects: &[Object], at_m: DVec3, rays: &[DVec3]) -> f64 {
    let is_open = |ray: &&DVec3| !objects.iter().any(|object| intersects(object, at_m, **ray));
    rays.iter().filter(is_open).count() as f64 / rays.len() as f64
}

/// Whether a ray meets an object: a rectangle without thickness, a cube, or a cylinder with a ball
/// at either end. A ray along a face divides by 0 and meets nothing.
fn intersects(object: &Object, from_m: DVec3, ray: DVec3) -> bool {
    let turn: DQuat = object.turn.as_dquat().conjugate();
    let (from_m, ray) = (turn * (from_m - object.position_m), turn * ray);
    match object.shape {
        Shape::Plane { width_m, height_m } => {
            let distance = -from_m.z / ray.z;
            let at_m = from_m + distance * ray;
            distance > 0.0
                && at_m.x.abs() < 0.5 * f64::from(width_m)
                && at_m.y.abs() < 0.5 * f64::from(height_m)
        }
        Shape::Cube { half_m } => (0..3).any(|axis| {
            let half_m = f64::from(half_m);
            let others = [(axis + 1) % 3, (axis + 2) % 3];
            [-half_m, half_m].iter().any(|face_m| {
                let distance = (face_m - from_m[axis]) / ray[axis];
                let at_m = from_m + distance * ray;
                distance > 0.0 && others.iter().all(|other| at_m[*other].abs() < half_m)
            })
        }),
        Shape::Capsule { radius_m, half_length_m } => {
            let (radius_m, half_m) = (f64::from(radius_m), f64::from(half_length_m));
            let meets_ball = |end_m: f64| {
                let to_m = end_m * DVec3::Z - from_m;
                let along = to_m.dot(ray);
                along > 0.0 && to_m.length_squared() - along * along < radius_m * radius_m
            };
            let (start_m, across) = (from_m.truncate(), ray.truncate());
            let (square, middle) = (across.length_squared(), start_m.dot(across));
            // No number where the ray passes the cylinder.
            let root = (middle * middle - square * (start_m.length_squared() - radius_m * radius_m)).sqrt();
            let meets_side = [-root, root].iter().any(|root| {
                let distance = (root - middle) / square;
                distance > 0.0 && (from_m.z + distance * ray.z).abs() < half_m
            });
            meets_side || meets_ball(half_m) || meets_ball(-half_m)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Share of a sun in the zenith that an object leaves at a place, metres east and south.
    fn left_at(object: Object, x: f64, z: f64) -> f64 {
        sun_share(&[object], DVec3::new(x, 0.0, z), &rays_to(DVec3::Y))
    }

    fn ball() -> Object {
        Object::ball(DVec3::new(0.0, 2.0, 0.0), 0.5, glam::Vec3::ZERO)
    }

    #[test]
    fn a_ball_shades_what_lies_behind_it_and_nothing_else() {
        assert_eq!(left_at(ball(), 0.0, 0.0), 0.0);
        assert_eq!(left_at(ball(), 0.6, 0.0), 1.0);
        assert_eq!(sun_share(&[ball()], DVec3::new(0.0, 4.0, 0.0), &rays_to(DVec3::Y)), 1.0);
    }

    #[test]
    fn every_shape_shades_its_outline_and_half_of_the_sun_at_its_rim() {
        let capsule = Object {
            shape: Shape::Capsule { radius_m: 0.5, half_length_m: 1.0 },
            turn: glam::Quat::IDENTITY,
            ..ball()
        };
        let cube = Object { shape: Shape::Cube { half_m: 1.0 }, turn: glam::Quat::IDENTITY, ..ball() };
        let plane = Object { shape: Shape::Plane { width_m: 2.0, height_m: 4.0 }, ..ball() };
        for (object, inside, outside, rim) in [
            (ball(), [0.3, 0.3], [0.4, 0.4], [0.5, 0.0]),
            (capsule, [0.45, 0.9], [0.4, 1.4], [0.5, 0.5]),
            (capsule, [0.0, 1.4], [0.0, 1.6], [0.0, 1.5]),
            (cube, [0.9, -0.9], [1.1, 0.0], [1.0, 0.0]),
            (plane, [0.9, 1.9], [1.1, 0.0], [0.0, -2.0]),
        ] {
            assert_eq!(left_at(object, inside[0], inside[1]), 0.0, "{object:?}");
            assert_eq!(left_at(object, outside[0], outside[1]), 1.0, "{object:?}");
            let rim = left_at(object, rim[0], rim[1]);
            assert!((0.4..0.6).contains(&rim), "{rim} at {object:?}");
        }
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
