//! Meshes of scene objects in object space: metres along u, along v and along the normal of a
//! plane, the axis of a capsule, the edges of a cube.
//!
//! Planes have walls of height 0; the shader raises their top and lowers their bottom for shells
//! and displaced geometry.

use crate::scene::objects::{Mode, Object, Shape};
use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// Segments along both sides of displaced geometry; equal to the shader's constant.
pub const GEOMETRY_SEGMENTS: u32 = 256;

/// Segments along both sides of a plain ground. Some drivers place a triangle of kilometres metres
/// off, so those near the middle, where the camera is, are small.
const GROUND_SEGMENTS: u32 = 32;

/// Segments around a capsule: its corners are within 0.08 % of the radius.
const AROUND: u32 = 160;
/// Segments from the middle of a capsule to a pole.
const TO_POLE: u32 = 40;

/// A vertex as `draw_pom.wesl` reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Vertex {
    /// Metres.
    pub place: [f32; 3],
    /// 1, or -1 at the bottom of a wall.
    pub end: f32,
    /// Unit vector.
    pub normal: [f32; 3],
    /// Outward direction of a wall along u.
    pub side_u: f32,
    /// Unit vector along u.
    pub tangent: [f32; 3],
    /// Along v.
    pub side_v: f32,
    /// Texture coordinates in tiles before the tiling setting; around a capsule, the share of the
    /// circumference.
    pub uv: [f32; 2],
}

/// Triangles, counter-clockwise from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// The vertices.
    pub vertices: Vec<Vertex>,
    /// Three for each triangle.
    pub indices: Vec<u32>,
}

impl Mesh {
    /// The mesh of an object.
    #[must_use]
    pub fn of(object: &Object) -> Self {
        match object.shape {
            Shape::Plane { width_m, height_m } => {
                let size = Vec2::new(width_m, height_m);
                match object.mode {
                    Mode::Geometry => Self::plane(size, object.tile_m, GEOMETRY_SEGMENTS, |part| part),
                    Mode::Plain => Self::plane(size, object.tile_m, GROUND_SEGMENTS, dense_in_the_middle),
                    _ => Self::plane(size, object.tile_m, 1, |part| part),
                }
            }
            Shape::Capsule { radius_m, half_length_m } => {
                Self::capsule(radius_m, half_length_m, object.tile_m)
            }
            Shape::Cube { half_m } => Self::cube(half_m, object.tile_m),
        }
    }

    /// A grid, and its four walls. `spaced` maps even steps from 0 to 1 to the places of grid
    /// lines.
    fn plane(size: Vec2, tile_m: f32, segments: u32, spaced: fn(f32) -> f32) -> Self {
        let mut mesh = Self::default();
        let vertex = |part: Vec2| {
            let place = (part - 0.5) * size;
            Vertex {
                place: place.extend(0.0).into(),
                end: 1.0,
                normal: Vec3::Z.into(),
                tangent: Vec3::X.into(),
                uv: (part * size / tile_m).into(),
                ..Vertex::default()
            }
        };
        let part = |step: u32| spaced(step as f32 / segments as f32);
        mesh.grid(segments, segments, |column, row| vertex(Vec2::new(part(column), part(row))));
        // Each wall along its edge, seen from outside from left to right.
        for side in [Vec2::NEG_Y, Vec2::X, Vec2::Y, Vec2::NEG_X] {
            let right = side.perp();
            mesh.grid(segments, 1, |column, row| {
                let corner = 0.5 + 0.5 * side + right * (part(column) - 0.5);
                let end = if row == 0 { -1.0 } else { 1.0 };
                Vertex { end, side_u: side.x, side_v: side.y, ..vertex(corner) }
            });
        }
        mesh
    }

    /// Rings from pole to pole.
    fn capsule(radius_m: f32, half_length_m: f32, tile_m: f32) -> Self {
        let mut mesh = Self::default();
        // The middle ring twice: the length lies between.
        mesh.grid(AROUND, 2 * TO_POLE + 1, |column, row| {
            let is_upper = row > TO_POLE;
            let step = if is_upper { row - 1 } else { row };
            let latitude = (step as f32 / TO_POLE as f32 - 1.0) * FRAC_PI_2;
            let longitude = column as f32 / AROUND as f32 * TAU - PI;
            let east = Vec2::from_angle(longitude);
            let normal = (east * latitude.cos()).extend(latitude.sin());
            let along = if is_upper { half_length_m } else { -half_length_m };
            let meridian = (latitude + FRAC_PI_2) * radius_m + along + half_length_m;
            Vertex {
                place: (normal * radius_m + Vec3::Z * along).into(),
                end: 1.0,
                normal: normal.into(),
                tangent: east.perp().extend(0.0).into(),
                uv: [column as f32 / AROUND as f32, meridian / tile_m],
                ..Vertex::default()
            }
        });
        mesh
    }

    /// Six faces.
    fn cube(half_m: f32, tile_m: f32) -> Self {
        let mut mesh = Self::default();
        for normal in [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z] {
            let sign = normal.element_sum();
            let tangent = if normal.x != 0.0 {
                Vec3::Y * sign
            } else if normal.y != 0.0 {
                Vec3::NEG_X * sign
            } else {
                Vec3::X * sign
            };
            mesh.grid(1, 1, |column, row| {
                let at = Vec2::new(column as f32, row as f32) * 2.0 - 1.0;
                let place = (normal + tangent * at.x + normal.cross(tangent) * at.y) * half_m;
                Vertex {
                    place: place.into(),
                    end: 1.0,
                    normal: normal.into(),
                    tangent: tangent.into(),
                    uv: ((at + 1.0) * half_m / tile_m).into(),
                    ..Vertex::default()
                }
            });
        }
        mesh
    }

    /// Adds a grid of cells; from outside, columns run to the right and rows up.
    fn grid(&mut self, columns: u32, rows: u32, vertex: impl Fn(u32, u32) -> Vertex) {
        let base = self.vertices.len() as u32;
        let corner = |column: u32, row: u32| base + row * (columns + 1) + column;
        self.vertices.extend(
            (0..=rows)
                .flat_map(|row| (0..=columns).map(move |column| (column, row)))
                .map(|(c, r)| vertex(c, r)),
        );
        for (column, row) in (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row))) {
            let [a, b, c, d] =
                [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(right, up)| corner(column + right, row + up));
            self.indices.extend([a, b, c, a, c, d]);
        }
    }
}

/// Grid lines with distances that grow from the middle as the third power of their number.
fn dense_in_the_middle(part: f32) -> f32 {
    let from_middle = 2.0 * part - 1.0;
    0.5 + 0.5 * from_middle.powi(3) * from_middle.abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use crate::scene::objects;

    fn corners(mesh: &Mesh, triangle: &[u32]) -> [Vec3; 3] {
        [0, 1, 2].map(|corner| {
            let vertex = &mesh.vertices[triangle[corner] as usize];
            // Walls with a height.
            Vec3::from(vertex.place) + Vec3::from(vertex.normal) * (0.1 * vertex.end)
        })
    }

    #[test]
    fn every_triangle_faces_outwards() {
        for object in [Scene::Pom, Scene::Brick, Scene::Spom].into_iter().flat_map(objects::of) {
            let mesh = Mesh::of(&object);
            for triangle in mesh.indices.chunks_exact(3) {
                let [a, b, c] = corners(&mesh, triangle);
                let vertex = &mesh.vertices[triangle[0] as usize];
                let (normal, tangent) = (Vec3::from(vertex.normal), Vec3::from(vertex.tangent));
                let side = tangent * vertex.side_u + normal.cross(tangent) * vertex.side_v;
                let outward = if side == Vec3::ZERO { normal } else { side };
                // At poles triangles have no area.
                assert!((b - a).cross(c - a).dot(outward) >= -1e-6, "{:?} {a} {b} {c}", object.shape);
            }
        }
    }

    #[test]
    fn the_ground_ends_where_it_should_and_has_small_triangles_near_the_middle() {
        let ground = objects::of(Scene::Spom).into_iter().find(|object| object.mode == Mode::Plain).unwrap();
        let mesh = Mesh::of(&ground);
        let lines: Vec<f32> =
            mesh.vertices[..=GROUND_SEGMENTS as usize].iter().map(|vertex| vertex.place[0]).collect();
        assert!(lines.is_sorted() && lines[0] == -10_000.0 && lines[GROUND_SEGMENTS as usize] == 10_000.0);
        let widest = lines.windows(2).filter(|pair| pair[1].abs() < 10.0).map(|pair| pair[1] - pair[0]);
        assert!(widest.fold(0.0, f32::max) < 10.0, "{lines:?}");
    }

    #[test]
    fn modes_and_segments_are_those_of_the_shader() {
        let text = shaders::SHADERS.draw_pom.wgsl;
        for (name, mode) in [
            ("PARAMS", Mode::Settings),
            ("FLAT", Mode::Flat),
            ("OFFSET", Mode::Offset),
            ("GEOMETRY", Mode::Geometry),
            ("PLAIN", Mode::Plain),
        ] {
            assert!(text.contains(&format!("MODE_{name}: u32 = {}u;", mode as u32)), "{name}");
        }
        assert!(text.contains(&format!("GEOMETRY_SEGMENTS: f32 = {GEOMETRY_SEGMENTS}.0;")));
    }

    #[test]
    fn displaced_geometry_has_as_many_triangles_as_it_says() {
        let objects = objects::of(Scene::Pom);
        let geometry = objects.iter().find(|object| object.mode == Mode::Geometry).unwrap();
        let walls = 4 * GEOMETRY_SEGMENTS * 2;
        assert_eq!(Mesh::of(geometry).indices.len() as u32 / 3, 131_072 + walls);
    }
}
