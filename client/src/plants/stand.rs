//! One kind of plants in a frame, as the shaders are told of it: what grows, from where it is
//! looked at, and on which patches.

use crate::frame::Shot;
use crate::plants::knobs::{Cull, PlantKnobs};
use crate::plants::square::Square;
use crate::world::World;
use glam::DVec3;
use shaders::layout::{
    CULL_DISTANCE, CULL_EXACT, CULL_FRUSTUM, CULL_HIERARCHICAL, CULL_MARCH, CULL_NOISE, Culling, Field,
    KIND_GRASS, KIND_TREES, Planting,
};
use shaders::twin::planting::{
    BLOCK_CELL_BITS, COARSE_BITS, Extent, PATCH_BLOCKS, distance_squared, lean_reach, may_be_in_view,
    wind_reach,
};
use shaders::twin::sight::Target;
use shaders::twin::surface::{FINE_BITS, NOWHERE, SQUARE_BITS, STEP_BITS, Surface, TILE_BITS};
use terrain::constants::UNITS_PER_METRE;

/// Fine units in a metre.
const FINE: f64 = (UNITS_PER_METRE << FINE_BITS) as f64;

/// Coarse units, in which squares of distances are counted, in a metre.
const COARSE: f64 = FINE / (1 << COARSE_BITS) as f64;

/// Share of the range over whose end heights sink to nothing.
const COLLAPSE: f32 = 0.25;

/// What is as near as the near plane is cut away; this much more for what is beside the middle of a
/// target.
const NEAR_ALLOWANCE: f64 = 1.5;

/// The plants of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantFrame {
    /// The land around the eye.
    pub square: Square,
    /// Kinds that grow in this frame, grass first.
    pub stands: Vec<Stand>,
    /// The knobs that it was made by.
    pub knobs: PlantKnobs,
}

/// One kind of plants.
#[derive(Clone, Debug, PartialEq)]
pub struct Stand {
    /// From where it is looked at.
    pub culling: Culling,
    /// What grows.
    pub planting: Planting,
    /// The same for the pass that draws it.
    pub field: Field,
    /// Patches of 16 x 16 blocks that may hold any of it: column and row in the square, nearest
    /// first.
    pub patches: Vec<[i32; 2]>,
}

/// Sizes and distances of a kind, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kind {
    /// `KIND_*`.
    pub kind: u32,
    /// log2 of the side of a cell, fine units.
    pub cell_bits: u32,
    /// Clumps of a cell at most.
    pub per_cell: u32,
    /// Least and greatest width.
    pub width_m: [f64; 2],
    /// Least and greatest height.
    pub height_m: [f64; 2],
    /// See [`PlantKnobs`].
    pub thin_from_m: f64,
    /// See [`PlantKnobs`].
    pub widest: f64,
    /// See [`PlantKnobs`].
    pub range_m: f64,
    /// Where the second and the third level of detail begin.
    pub detail_m: [f64; 2],
}

impl Kind {
    /// Grass by the knobs.
    #[must_use]
    pub fn grass(knobs: &PlantKnobs) -> Self {
        Self {
            kind: KIND_GRASS,
            cell_bits: STEP_BITS,
            per_cell: knobs.density,
            width_m: [0.16, 0.36],
            height_m: [0.22, 0.62],
            thin_from_m: f64::from(knobs.thin_from_m),
            widest: f64::from(knobs.widest),
            range_m: f64::from(knobs.range_m),
            detail_m: [12.0, 45.0],
        }
    }

    /// Trees by the knobs.
    #[must_use]
    pub fn trees(knobs: &PlantKnobs) -> Self {
        Self {
            kind: KIND_TREES,
            cell_bits: STEP_BITS + 2,
            per_cell: knobs.trees,
            width_m: [2.6, 5.0],
            height_m: [6.0, 14.0],
            // Trees are not thinned: one that vanishes is seen.
            thin_from_m: f64::from(knobs.tree_range_m).max(1.0),
            widest: 1.0,
            range_m: f64::from(knobs.tree_range_m),
            detail_m: [90.0, 1e6],
        }
    }

    /// What the pass that draws the kind is told.
    fn field(&self, eye: [i32; 3], knobs: &PlantKnobs) -> Field {
        let metres = |pair: [f64; 2]| pair.map(|metres| metres as f32);
        let [width_low_m, width_high_m] = metres(self.width_m);
        let [height_low_m, height_high_m] = metres(self.height_m);
        let range_m = self.range_m as f32;
        Field {
            eye_x: eye[0],
            eye_y: eye[1],
            eye_z: eye[2],
            kind: self.kind,
            width_low_m,
            width_high_m,
            height_low_m,
            height_high_m,
            thin_from_m: self.thin_from_m as f32,
            widest: self.widest as f32,
            range_m,
            collapse_m: COLLAPSE * range_m,
            lod_m: metres(self.detail_m),
            wind: knobs.wind,
            lean: knobs.lean,
        }
    }

    fn planting(&self, square: &Square, seed: u32, knobs: &PlantKnobs) -> Planting {
        let fine = |metres: f64| (metres * FINE).round() as i32;
        let [width_low, width_high] = self.width_m.map(fine);
        let [height_low, height_high] = self.height_m.map(fine);
        let half = (f64::from(width_high) * self.widest / 2.0).ceil() as i32 + 2;
        let (reach, over) = if self.kind == KIND_GRASS {
            (half + 3 * height_high / 4 + 2, height_high + half + 2)
        } else {
            (half, height_high + 2)
        };
        let cell = |low: i32| low >> (self.cell_bits - FINE_BITS);
        let squared = |metres: f64| ((metres * COARSE + 2.0).powi(2)).clamp(0.0, 3e9) as u32;
        let stands_within = |rank: usize| {
            // The widest clump of a rank vanishes where the thinning of `shared/field.wesl` leaves
            // nothing of it.
            let share = (rank as f64 + 0.5) / 256.0;
            let least = (share / 1.125).min(share - 0.5 / 256.0).max(1e-9);
            squared((self.thin_from_m / least).min(self.range_m))
        };
        Planting {
            kind: self.kind,
            seed,
            cell_bits: self.cell_bits,
            per_cell: self.per_cell,
            cell_x: cell(square.corner[0]),
            cell_z: cell(square.corner[1]),
            width_low,
            width_span: width_high - width_low,
            height_low,
            height_span: height_high - height_low,
            thin_from: fine(self.thin_from_m),
            widest: (self.widest * 256.0).ceil() as u32,
            reach,
            over,
            range: (self.range_m * COARSE).ceil() as i32,
            collapse: (f64::from(COLLAPSE) * self.range_m * COARSE).ceil().max(1.0) as i32,
            detail: self.detail_m.map(squared),
            wind_reach: wind_reach(knobs.wind),
            lean_reach: lean_reach(knobs.lean),
            stands_within: std::array::from_fn(|row| {
                std::array::from_fn(|column| stands_within(4 * row + column))
            }),
            vertices: [0; 4],
            room: [0; 4],
        }
    }
}

impl Shot {
    /// The plants of a frame over what it draws; none if nothing grows or nothing is drawn.
    #[must_use]
    pub fn plants(&self, world: &World, drawn: &[crate::world::Drawn]) -> Option<PlantFrame> {
        let knobs = self.looks.plants.sane();
        let seed = drawn.iter().find_map(|drawn| world.get(drawn.key)).map(|chunk| chunk.grass.seed)?;
        if !knobs.any() {
            return None;
        }
        let square = Square::around(&self.pose.eye(), world, drawn);
        let culling = self.culling(&square, world, &knobs);
        let kinds = [Kind::grass(&knobs), Kind::trees(&knobs)];
        let grows = |kind: &Kind| kind.per_cell > 0 && kind.range_m > 0.0;
        // Land that has dissolved carries nothing.
        let reach_m = f64::from(self.view_distance_m) * 0.8;
        let stands = kinds.into_iter().filter(grows).map(|kind| {
            let kind = Kind { range_m: kind.range_m.min(reach_m), ..kind };
            let planting = kind.planting(&square, seed, &knobs);
            let patches = patches(&square, &culling, &planting);
            Stand { culling, planting, field: kind.field(culling.eye, &knobs), patches }
        });
        Some(PlantFrame { stands: stands.collect(), square, knobs })
    }

    fn culling(&self, square: &Square, world: &World, knobs: &PlantKnobs) -> Culling {
        let eye = self.pose.eye();
        let at = square.eye(&eye);
        let half_height = self.lens.half_height();
        let half_width = half_height * self.lens.aspect();
        let corner = (1.0 + half_height * half_height + half_width * half_width).sqrt();
        let slots = super::kept::BySlot::new(world);
        let surface = Surface { slots: &slots, tiles: &square.tiles, leaves: &square.leaves };
        let ground = surface.height_at(at[0], at[2]);
        let noise = world.land().map(terrain::Land::parameters);
        Culling {
            eye: at,
            path: match knobs.cull {
                Cull::Distance => CULL_DISTANCE,
                Cull::Frustum => CULL_FRUSTUM,
                Cull::Noise => CULL_NOISE,
                Cull::March => CULL_MARCH,
                Cull::Exact => CULL_EXACT,
                Cull::Hierarchical => CULL_HIERARCHICAL,
            },
            planes: self.planes(half_width, half_height),
            start: (f64::from(crate::camera::NEAR_M) * corner * NEAR_ALLOWANCE * FINE).ceil().min(FINE * 64.0)
                as i32,
            // An eye in the ground looks at the land from below, where it is not drawn.
            sees_land: u32::from(ground > NOWHERE << FINE_BITS && ground < at[1]),
            step: (f64::from(knobs.step_m) * FINE) as i32,
            stay: knobs.stay,
            corner: square.corner,
            frame: 0,
            archipelago_seed: noise.map_or(0, |noise| noise.archipelago_seed),
            octave_seeds: noise.map_or([0; 8], |noise| noise.octave_seeds),
            stretch: world.stretch(),
            reserved: [0; 3],
        }
    }

    /// Inward normals of the four side planes, Q14.
    fn planes(&self, half_width: f64, half_height: f64) -> [[i32; 4]; 4] {
        let (forward, right, up) = (self.pose.forward(), self.pose.right(), self.pose.up());
        let quantised = |normal: DVec3| {
            let [x, y, z] = (normal.normalize_or_zero() * f64::from(1 << 14)).to_array();
            [x.round() as i32, y.round() as i32, z.round() as i32, 0]
        };
        [
            right + forward * half_width,
            forward * half_width - right,
            up + forward * half_height,
            forward * half_height - up,
        ]
        .map(quantised)
    }
}

/// The patches of a kind within its distance and, unless the path does without, inside the view;
/// nearest first.
fn patches(square: &Square, culling: &Culling, planting: &Planting) -> Vec<[i32; 2]> {
    let bits = planting.cell_bits + BLOCK_CELL_BITS + PATCH_BLOCKS.trailing_zeros();
    let side = 1 << bits;
    let count = 1 << (SQUARE_BITS - bits);
    let places = (0..count).flat_map(|row| (0..count).map(move |column| [column, row]));
    let mut found: Vec<(u32, [i32; 2])> = places
        .filter_map(|[column, row]| {
            let (west, north) = (column << bits, row << bits);
            let nearest =
                [culling.eye[0].clamp(west, west + side), culling.eye[2].clamp(north, north + side)];
            let far = distance_squared(culling, nearest[0], culling.eye[1], nearest[1]);
            let (top, bottom) = bounds(square, bits, column, row)?;
            let half = side / 2;
            let extent = Extent {
                target: Target {
                    x: west + half,
                    z: north + half,
                    top: top + planting.over,
                    radius: (half >> 5) * 46 + planting.reach,
                    follow: (half >> 5) * 46 + planting.reach,
                    skirt: 0,
                    fall: 0,
                    east_rise: 0,
                    south_rise: 0,
                },
                bottom: bottom - planting.reach,
            };
            let is_seen = culling.path == CULL_DISTANCE || may_be_in_view(culling, &extent);
            (far <= planting.stands_within[0][0] && is_seen).then_some((far, [column, row]))
        })
        .collect();
    found.sort_unstable();
    found.into_iter().map(|(_, patch)| patch).collect()
}

/// Highest and lowest drawn point of a patch, fine units; none where nothing is drawn.
fn bounds(square: &Square, bits: u32, column: i32, row: i32) -> Option<(i32, i32)> {
    let tiles = 1 << (bits - TILE_BITS);
    let side = shaders::layout::SQUARE_TILES;
    let under = (row * tiles..(row + 1) * tiles)
        .flat_map(|z| (column * tiles..(column + 1) * tiles).map(move |x| (z * side + x) as usize))
        .map(|index| square.tiles[index])
        .filter(|tile| tile.leaf != shaders::layout::NO_LEAF);
    under.fold(None, |bounds, tile| {
        let (top, bottom) = bounds.unwrap_or((i32::MIN, i32::MAX));
        Some((top.max(tile.top << FINE_BITS), bottom.min(tile.bottom << FINE_BITS)))
    })
}
