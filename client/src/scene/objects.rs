//! Objects of the parallax scenes.

use crate::camera::Eye;
use crate::features::pom::settings::Silhouette;
use crate::scene::Scene;
use glam::{DVec3, Quat, Vec2, Vec3};
use shaders::layout::PomObject;
use std::f32::consts::{FRAC_PI_2, TAU};
use terrain::constants::UNITS_PER_METRE;

/// Material set of all objects: cobbles; in the brick scene, bricks.
pub const LAYER: u32 = 6;

/// Metres from height 0 to height 1 of cobbles, over the metres of a tile: round heads, deep
/// joints.
const COBBLES_RELIEF: f32 = 0.04;

/// Side of the planes that are compared, metres.
pub const PLANE_M: f32 = 5.0;
/// Gap between them, metres.
const GAP_M: f32 = 0.5;

/// Parallax method of an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// By the settings.
    Settings,
    /// None: flat.
    Flat,
    /// Parallax mapping with a single offset.
    Offset,
    /// Displaced geometry: the reference. Planes only.
    Geometry,
    /// A plain object of one colour.
    Plain,
}

/// Form and size of an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A rectangle across the third axis.
    Plane {
        /// Along the first axis.
        width_m: f32,
        /// Along the second.
        height_m: f32,
    },
    /// A cylinder along the third axis with round ends; a sphere if it has no length.
    Capsule {
        /// Of cylinder and ends.
        radius_m: f32,
        /// Half the length of the cylinder alone.
        half_length_m: f32,
    },
    /// A cube along the axes.
    Cube {
        /// Half its side.
        half_m: f32,
    },
}

/// An object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Object {
    /// Form and size.
    pub shape: Shape,
    /// How its relief is found.
    pub mode: Mode,
    /// Its middle, metres east, up, south.
    pub position_m: DVec3,
    /// Rotation from object to world axes.
    pub turn: Quat,
    /// Metres of a material tile, before the tiling setting.
    pub tile_m: f32,
    /// Metres from height 0 to height 1, before the amplitude setting.
    pub relief_m: f32,
    /// Silhouette where the setting is [`Silhouette::None`].
    pub silhouette: Silhouette,
    /// Colour of a plain object, linear.
    pub tint: Vec3,
}

impl Object {
    /// A plane on the ground with cobbles, first axis east, second north, a material tile `tile_m`
    /// metres wide.
    #[must_use]
    pub fn ground(mode: Mode, position_m: DVec3, side_m: f32, tile_m: f32) -> Self {
        Self {
            shape: Shape::Plane { width_m: side_m, height_m: side_m },
            mode,
            position_m,
            // Up is the third axis.
            turn: Quat::from_rotation_x(-FRAC_PI_2),
            tile_m,
            relief_m: COBBLES_RELIEF * tile_m,
            silhouette: Silhouette::None,
            tint: Vec3::ZERO,
        }
    }

    /// A ball of one colour.
    #[must_use]
    pub fn ball(position_m: DVec3, radius_m: f32, tint: Vec3) -> Self {
        Self {
            shape: Shape::Capsule { radius_m, half_length_m: 0.0 },
            mode: Mode::Plain,
            tint,
            ..Self::ground(Mode::Plain, position_m, 1.0, 1.0)
        }
    }

    /// Shader data for an eye, with the material repeated `tiling` times as often. Around a capsule
    /// the repeats are rounded to a whole number, so that tiles meet. Subtraction in f64, so that
    /// positions are exact at any distance from the origin.
    #[must_use]
    pub fn layout(&self, eye: &Eye, tiling: Vec2) -> PomObject {
        // Plain objects have no material to repeat.
        let tiling = if self.mode == Mode::Plain { Vec2::ONE } else { tiling };
        let tile_m = self.tile_m / tiling;
        let around = match self.shape {
            Shape::Capsule { radius_m, .. } => (TAU * radius_m / tile_m.x).round().max(1.0),
            Shape::Plane { .. } | Shape::Cube { .. } => tiling.x,
        };
        let whole = DVec3::from_array(eye.units.map(f64::from)) / f64::from(UNITS_PER_METRE);
        let (shape, size_m) = match self.shape {
            Shape::Plane { width_m, height_m } => (0, [width_m, height_m]),
            Shape::Capsule { radius_m, half_length_m } => (1, [radius_m, half_length_m]),
            Shape::Cube { half_m } => (2, [half_m, half_m]),
        };
        PomObject {
            origin_m: ((self.position_m - whole) - eye.fraction_m.as_dvec3()).as_vec3().into(),
            mode: self.mode as u32,
            tangent: (self.turn * Vec3::X).into(),
            silhouette: self.silhouette as u32,
            bitangent: (self.turn * Vec3::Y).into(),
            shape,
            normal: (self.turn * Vec3::Z).into(),
            layer: LAYER,
            size_m,
            tile_m: tile_m.into(),
            tint: self.tint.into(),
            relief_m: self.relief_m,
            repeats: [around, tiling.y],
            reserved: [0.0; 2],
        }
    }
}

/// The largest height range of a scene at amplitude 1, metres; none without one.
#[must_use]
pub fn tallest_relief_m(scene: Scene) -> Option<f32> {
    of(scene).iter().map(|object| object.relief_m).reduce(f32::max).filter(|relief_m| *relief_m > 0.0)
}

/// Objects of a scene; none without parallax.
#[must_use]
pub fn of(scene: Scene) -> Vec<Object> {
    match scene {
        Scene::Island | Scene::Grass | Scene::Culling | Scene::Water => Vec::new(),
        Scene::Pom => pom(),
        Scene::Brick => brick(),
        Scene::Spom => spom(),
    }
}

/// The compared methods, from left to right.
pub const COMPARED: [Mode; 4] = [Mode::Flat, Mode::Offset, Mode::Settings, Mode::Geometry];

const SAND: Vec3 = Vec3::new(0.19, 0.155, 0.11);
const CLAY: Vec3 = Vec3::new(0.62, 0.16, 0.05);
const CHALK: Vec3 = Vec3::new(0.62, 0.60, 0.55);

/// Ground plane up to the horizon.
fn floor(height_m: f64) -> Object {
    let plane = Object::ground(Mode::Plain, DVec3::new(0.0, height_m, 0.0), 20_000.0, 1.0);
    Object { tint: SAND, relief_m: 0.0, ..plane }
}

/// Four planes side by side, with a ball and a tilted slab in each.
fn pom() -> Vec<Object> {
    let mut objects = vec![floor(-0.101)];
    for (column, mode) in COMPARED.into_iter().enumerate() {
        let middle_m = DVec3::new((column as f64 - 1.5) * f64::from(PLANE_M + GAP_M), 0.0, 0.0);
        objects.push(Object::ground(mode, middle_m, PLANE_M, PLANE_M));
        objects.push(Object::ball(middle_m + DVec3::new(-1.2, 0.05, -1.1), 0.45, CLAY));
        objects.push(Object {
            shape: Shape::Capsule { radius_m: 0.16, half_length_m: 0.75 },
            turn: Quat::from_rotation_y(0.5) * Quat::from_rotation_x(0.12),
            ..Object::ball(middle_m + DVec3::new(1.3, 0.02, -1.0), 0.16, CHALK)
        });
    }
    objects
}

/// Side of a tile of bricks, metres: six bricks wide, twelve courses high.
pub const BRICK_TILE_M: f32 = 1.5;

/// Metres from the mortar to the face of the bricks.
pub const BRICK_RELIEF_M: f32 = 0.06;

/// A wall that faces south.
fn brick() -> Vec<Object> {
    let (width_m, height_m) = (4.0 * BRICK_TILE_M, 2.0 * BRICK_TILE_M);
    let wall = Object {
        shape: Shape::Plane { width_m, height_m },
        turn: Quat::IDENTITY,
        relief_m: BRICK_RELIEF_M,
        ..Object::ground(Mode::Settings, DVec3::new(0.0, f64::from(height_m) / 2.0, 0.0), 1.0, BRICK_TILE_M)
    };
    vec![floor(0.0), wall]
}

/// A plane, a sphere, a capsule and a cube, each with a suitable silhouette: the rectangle for a
/// plane, the horizon and the shell for sphere and capsule, the shell for a cube (the horizon cuts
/// holes into flat faces seen from the side).
fn spom() -> Vec<Object> {
    let tile_m = 2.8;
    let object = |shape, x_m: f64, y_m: f64, turn, silhouette| Object {
        shape,
        turn,
        silhouette,
        ..Object::ground(Mode::Settings, DVec3::new(x_m, y_m, 0.0), 1.0, tile_m)
    };
    let plane = Object {
        silhouette: Silhouette::Rectangle,
        turn: Quat::from_rotation_x(-0.75),
        ..Object::ground(Mode::Settings, DVec3::new(-4.5, 0.6, 0.0), 2.6, tile_m)
    };
    // Puts both poles, where the material shrinks, on the limb.
    let leaning = Quat::from_rotation_x(-FRAC_PI_2 - 0.27);
    vec![
        floor(-0.4),
        plane,
        object(
            Shape::Capsule { radius_m: 1.15, half_length_m: 0.0 },
            -1.7,
            0.8,
            leaning,
            Silhouette::Horizon,
        ),
        object(
            Shape::Capsule { radius_m: 0.75, half_length_m: 0.9 },
            1.4,
            1.2,
            Quat::from_rotation_x(-FRAC_PI_2),
            Silhouette::Shell,
        ),
        object(Shape::Cube { half_m: 0.9 }, 4.4, 0.5, Quat::from_rotation_y(0.6), Silhouette::Shell),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Pose;

    #[test]
    fn tiles_meet_around_every_capsule_and_what_has_no_material_is_not_tiled() {
        let eye = Pose { position_m: DVec3::ZERO, yaw_deg: 0.0, pitch_deg: 0.0 }.eye();
        for object in of(Scene::Spom) {
            for tiling in [Vec2::ONE, Vec2::new(1.7, 0.3), Vec2::new(0.25, 8.0)] {
                let layout = object.layout(&eye, tiling);
                if object.mode == Mode::Plain {
                    assert_eq!((layout.tile_m, layout.repeats), ([object.tile_m; 2], [1.0; 2]));
                    continue;
                }
                assert_eq!(layout.tile_m, (object.tile_m / tiling).to_array());
                let is_round = matches!(object.shape, Shape::Capsule { .. });
                let expected = if is_round { layout.repeats[0].round().max(1.0) } else { tiling.x };
                assert_eq!(layout.repeats, [expected, tiling.y], "{object:?}");
            }
        }
    }

    #[test]
    fn places_are_exact_however_far_from_the_origin_and_axes_are_right_handed() {
        for object in [Scene::Pom, Scene::Brick, Scene::Spom].into_iter().flat_map(of) {
            let seen = |away: DVec3| {
                let position_m = DVec3::new(1.5, 2.25, 3.0) + away;
                let eye = Pose { position_m, yaw_deg: 0.0, pitch_deg: 0.0 }.eye();
                Object { position_m: object.position_m + away, ..object }.layout(&eye, Vec2::ONE)
            };
            assert_eq!(seen(DVec3::ZERO).origin_m, seen(DVec3::new(2e6, 0.0, -1e6)).origin_m);
            let layout = seen(DVec3::ZERO);
            let [u, v, n] = [layout.tangent, layout.bitangent, layout.normal].map(Vec3::from);
            assert!((u.cross(v) - n).length() < 1e-6, "{object:?}");
        }
    }
}
