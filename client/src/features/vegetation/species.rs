//! Shader parameters of the vegetation of a frame.

use crate::cache::ChunkCache;
use crate::camera::{NEAR_M, Pose, Projection};
use crate::features::vegetation::by_slot::BySlot;
use crate::features::vegetation::far_trees::{FarTreeFrame, FarTreeView};
use crate::features::vegetation::occlusion_grid::OcclusionGrid;
use crate::features::vegetation::settings::{Cull, REACHED, VegetationSettings};
use crate::frustum::Frustum;
use crate::lod::Drawn;
use glam::DVec3;
use shaders::layout::{
    CULL_DISTANCE, CULL_EXACT, CULL_FRUSTUM, CULL_HIERARCHICAL, CULL_MARCH, CULL_NOISE, Culling, Field,
    KIND_GRASS, KIND_TREES, MOST_TREE_GRID_CELLS, Planting, TREE_CELL_M,
};
use shaders::twin::placement::{BLOCK_CELL_BITS, COARSE_BITS, PATCH_BLOCKS, distance_squared};
use shaders::twin::surface::{FINE_BITS, GRID_BITS, NOWHERE, STEP_BITS, Surface, TILE_BITS};
use shaders::twin::terrain_occlusion::Occludee;
use shaders::twin::visibility::{Extent, lean_reach, may_be_in_view, spread_of, wind_reach};
use terrain::constants::UNITS_PER_METRE;

/// Fine units in a metre.
const FINE: f64 = (UNITS_PER_METRE << FINE_BITS) as f64;

/// Coarse units in a metre; squared distances are in coarse units.
const COARSE: f64 = FINE / (1 << COARSE_BITS) as f64;

/// Share of the range over which heights collapse to 0 at its end.
const COLLAPSE: f32 = 0.25;

/// Far trees are thinned from here on, metres, unless they begin farther away; each as much wider
/// as there are fewer.
const FAR_THIN_FROM_M: f64 = 1500.0;

/// Far trees begin so much nearer than single ones end, metres: none falls between their distances,
/// which are rounded to 1/16 m.
const FAR_OVERLAP_M: f64 = 0.5;

/// Pixels per radian from which on plants have their full detail: 416 lines of a lens of 60
/// degrees, in which a blade at 3 m is about a pixel wide.
pub const FULL_DETAIL_PX: f64 = 360.0;

/// Least factor of the distances of detail of grass: that of 83 lines.
pub const LEAST_DETAIL: f64 = 0.2;

/// Least factor of those of trees.
pub const LEAST_DETAIL_OF_TREES: f64 = 0.5;

/// Width of a crown of mean size, metres, and its least width in pixels where its tree casts a
/// shadow of its own.
const CROWN_M: f64 = 4.5;
const LEAST_CROWN_PX: f64 = 3.0;

/// Each tree is known at least up to here, metres, in images with fewer pixels too; at most as far
/// as trees are culled one by one.
const LEAST_KNOWN_M: f64 = 500.0;

/// Factor of the near-plane distance inside which occlusion is not tested: covers targets off the
/// view axis.
const NEAR_ALLOWANCE: f64 = 1.5;

/// The vegetation of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct VegetationFrame {
    /// The drawn land around the eye.
    pub grid: OcclusionGrid,
    /// Species of this frame, grass first.
    pub species: Vec<SpeciesParams>,
    /// Trees beyond the range of per-tree culling.
    pub far_trees: Option<FarTreeFrame>,
    /// The settings of the frame.
    pub settings: VegetationSettings,
}

/// Parameters of one species.
#[derive(Clone, Debug, PartialEq)]
pub struct SpeciesParams {
    /// Eye, frustum and method of culling.
    pub culling: Culling,
    /// Placement of the clumps.
    pub planting: Planting,
    /// Parameters of the draw pass.
    pub field: Field,
    /// Patches of 16 x 16 blocks that may hold visible clumps: column and row in the grid, nearest
    /// first.
    pub patches: Vec<[i32; 2]>,
}

/// Sizes and distances of a species, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeciesTraits {
    /// `KIND_*`.
    pub kind: u32,
    /// log2 of the side of a cell, fine units.
    pub cell_bits: u32,
    /// Most clumps of a cell.
    pub per_cell: u32,
    /// Least and greatest width.
    pub width_m: [f64; 2],
    /// Least and greatest height.
    pub height_m: [f64; 2],
    /// See [`VegetationSettings`].
    pub thin_from_m: f64,
    /// See [`VegetationSettings`].
    pub widest: f64,
    /// See [`VegetationSettings`].
    pub range_m: f64,
    /// Where the second and the third level of detail begin, at [`FULL_DETAIL_PX`] and more.
    pub detail_m: [f64; 2],
    /// Factor of these distances, `least_detail` to 1: fewer pixels need less detail.
    pub detail_scale: f64,
    /// The shapes of the levels of trees differ more than those of grass.
    pub least_detail: f64,
    /// Plants of this kind stand up to here, by whatever pass, metres.
    pub stand_m: f64,
    /// See [`Field::tree_grid_cells`].
    pub tree_grid_cells: u32,
}

impl SpeciesTraits {
    /// Grass by the settings.
    #[must_use]
    pub fn grass(settings: &VegetationSettings) -> Self {
        Self {
            kind: KIND_GRASS,
            cell_bits: STEP_BITS,
            per_cell: settings.density,
            width_m: [0.16, 0.36],
            height_m: [0.26, 0.62],
            thin_from_m: f64::from(settings.thin_from_m),
            widest: f64::from(settings.widest),
            range_m: f64::from(settings.range_m),
            detail_m: [10.0, 32.0],
            detail_scale: 1.0,
            least_detail: LEAST_DETAIL,
            stand_m: f64::from(settings.range_m),
            tree_grid_cells: MOST_TREE_GRID_CELLS as u32,
        }
    }

    /// Trees that are culled by themselves, by the settings.
    #[must_use]
    pub fn trees(settings: &VegetationSettings) -> Self {
        let range_m = f64::from(settings.tree_range_m.min(settings.single_trees_m));
        Self {
            kind: KIND_TREES,
            cell_bits: STEP_BITS + 2,
            per_cell: settings.trees,
            width_m: [3.2, 6.4],
            height_m: [6.0, 14.0],
            // Trees are not thinned: a vanishing tree is noticed.
            thin_from_m: range_m.max(1.0),
            widest: 1.0,
            range_m,
            detail_m: [
                50.0_f64.min(f64::from(settings.impostors_from_m)),
                f64::from(settings.impostors_from_m),
            ],
            detail_scale: 1.0,
            least_detail: LEAST_DETAIL_OF_TREES,
            stand_m: f64::from(settings.tree_range_m),
            tree_grid_cells: MOST_TREE_GRID_CELLS as u32,
        }
    }

    /// The trees beyond those, up to `stand_m`; thinned.
    #[must_use]
    pub fn far_trees(&self) -> Self {
        let thin_from_m = FAR_THIN_FROM_M.max(self.range_m);
        Self { thin_from_m, widest: (self.stand_m / thin_from_m).max(1.0), range_m: self.stand_m, ..*self }
    }

    /// Whether trees stand beyond those that are culled by themselves.
    fn goes_on(&self) -> bool {
        self.stand_m > self.range_m
    }

    /// Share of the range over which heights sink to 0 at its end: where other trees go on, none
    /// do.
    fn collapse(&self) -> f64 {
        if self.goes_on() { 0.0 } else { f64::from(COLLAPSE) }
    }

    /// Where the second and the third level of detail begin.
    fn detail_begins_m(&self) -> [f64; 2] {
        self.detail_m.map(|metres| metres * self.detail_scale)
    }

    /// Parameters of the draw pass.
    fn field(&self, eye: [i32; 3], settings: &VegetationSettings) -> Field {
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
            collapse_m: self.collapse() as f32 * range_m,
            lod_m: metres(self.detail_begins_m()),
            wind: settings.wind,
            lean: settings.lean,
            casts: settings.shadows as u32,
            detail: (1.0 / self.detail_scale) as f32,
            stand_m: self.stand_m as f32,
            tree_grid_cells: self.tree_grid_cells,
        }
    }

    fn planting(&self, grid: &OcclusionGrid, seed: u32, settings: &VegetationSettings) -> Planting {
        let fine = |metres: f64| (metres * FINE).round() as i32;
        let [width_low, width_high] = self.width_m.map(fine);
        let [height_low, height_high] = self.height_m.map(fine);
        let half = (f64::from(width_high) * self.widest / 2.0).ceil() as i32 + 2;
        let (reach, over) = if self.kind == KIND_GRASS {
            let half = half + spread_of(self.kind, false);
            (half + 3 * height_high / 4 + 2, height_high + half + 2)
        } else {
            (half, height_high + 2)
        };
        let cell = |low: i32| low >> (self.cell_bits - FINE_BITS);
        let squared = |metres: f64| ((metres * COARSE + 2.0).powi(2)).clamp(0.0, 3e9) as u32;
        let draw_distance_squared = |rank: usize| {
            // The widest clump of a rank vanishes where the thinning of the shader leaves a width
            // of 0.
            let share = (rank as f64 + 0.5) / 256.0;
            let least = (share / 1.125).min(share - 0.5 / 256.0).max(1e-9);
            squared((self.thin_from_m / least).min(self.range_m))
        };
        Planting {
            kind: self.kind,
            seed,
            cell_bits: self.cell_bits,
            per_cell: self.per_cell,
            cell_x: cell(grid.corner[0]),
            cell_z: cell(grid.corner[1]),
            width_low,
            width_span: width_high - width_low,
            height_low,
            height_span: height_high - height_low,
            thin_from: fine(self.thin_from_m),
            widest: (self.widest * 256.0).ceil() as u32,
            reach,
            over,
            range: (self.range_m * COARSE).ceil() as i32,
            collapse: (self.collapse() * self.range_m * COARSE).ceil().max(1.0) as i32,
            detail: self.detail_begins_m().map(squared),
            wind_reach: wind_reach(settings.wind),
            lean_reach: lean_reach(settings.lean),
            draw_distance_squared: std::array::from_fn(|row| {
                std::array::from_fn(|column| draw_distance_squared(4 * row + column))
            }),
            vertices: [0; 4],
            room: [0; 4],
        }
    }
}

impl VegetationFrame {
    /// The vegetation over the drawn chunks; none without plants or without drawn chunks.
    #[must_use]
    pub fn new(
        pose: &Pose,
        projection: &Projection,
        view_distance_m: u32,
        settings: VegetationSettings,
        cache: &ChunkCache,
        drawn: &[Drawn],
    ) -> Option<Self> {
        let seed = drawn.iter().find_map(|drawn| cache.get(drawn.key)).map(|chunk| chunk.grass.seed)?;
        if !settings.any() {
            return None;
        }
        let grid = OcclusionGrid::around(&pose.eye(), cache, drawn);
        let culling = culling_params(pose, projection, &grid, cache, &settings);
        // Land near the view distance is dissolved and carries no plants.
        let reach_m = f64::from(view_distance_m) * REACHED;
        let traits =
            [SpeciesTraits::grass(&settings), SpeciesTraits::trees(&settings)].map(|traits| SpeciesTraits {
                range_m: traits.range_m.min(reach_m),
                stand_m: traits.stand_m.min(reach_m),
                detail_scale: detail_scale(projection, traits.least_detail),
                tree_grid_cells: tree_grid_cells(projection, traits.range_m.min(reach_m)),
                ..traits
            });
        let frustum = Frustum::new(pose, projection);
        let view = FarTreeView {
            eye: &pose.eye(),
            frustum: (settings.cull != Cull::Distance).then_some(&frustum),
            cache,
            drawn,
        };
        let [_, trees] = &traits;
        let far_trees = (trees.per_cell > 0 && trees.goes_on())
            .then(|| {
                let far = trees.far_trees();
                let begin_m = (trees.range_m - FAR_OVERLAP_M).max(0.0);
                let params = (far.field(culling.eye, &settings), far.planting(&grid, seed, &settings));
                let margin_m = [0.5 * far.width_m[1] * far.widest, far.height_m[1]];
                FarTreeFrame::new(&view, [begin_m, far.range_m], margin_m, params)
            })
            .flatten();
        let exists = |traits: &SpeciesTraits| traits.per_cell > 0 && traits.range_m > 0.0;
        let species = traits.into_iter().filter(exists).map(|traits| {
            let planting = traits.planting(&grid, seed, &settings);
            let patches = patches(&grid, &culling, &planting);
            SpeciesParams { culling, planting, field: traits.field(culling.eye, &settings), patches }
        });
        Some(Self { species: species.collect(), far_trees, grid, settings })
    }
}

/// Factor of the distances at which the detail of plants falls, for images of this lens and size,
/// at least `least`.
fn detail_scale(projection: &Projection, least: f64) -> f64 {
    let pixels_per_radian = f64::from(projection.height) / (2.0 * projection.half_height());
    (pixels_per_radian / FULL_DETAIL_PX).clamp(least, 1.0)
}

/// Cells along a side of the square in which each tree is known: up to where a crown is
/// [`LEAST_CROWN_PX`] pixels wide and at least [`LEAST_KNOWN_M`], as far as trees stand one by one.
fn tree_grid_cells(projection: &Projection, range_m: f64) -> u32 {
    let pixels_per_radian = f64::from(projection.height) / (2.0 * projection.half_height());
    let known_m = (CROWN_M / LEAST_CROWN_PX * pixels_per_radian).max(LEAST_KNOWN_M).min(range_m);
    // Twin: `known_in_grid_m` of `shared/tree_cells.wesl`.
    let cells = 2 * (known_m / f64::from(TREE_CELL_M) + 1.5).ceil() as usize;
    cells.next_multiple_of(8).min(MOST_TREE_GRID_CELLS) as u32
}

fn culling_params(
    pose: &Pose,
    projection: &Projection,
    grid: &OcclusionGrid,
    cache: &ChunkCache,
    settings: &VegetationSettings,
) -> Culling {
    let at = grid.eye(&pose.eye());
    let half_height = projection.half_height();
    let half_width = half_height * projection.aspect();
    let corner = (1.0 + half_height * half_height + half_width * half_width).sqrt();
    let slots = BySlot::new(cache);
    let surface = Surface { slots: &slots, nodes: &grid.nodes, chunks: &grid.chunks };
    let ground = surface.height_at(at[0], at[2]);
    let noise = cache.land().map(terrain::Land::parameters);
    Culling {
        eye: at,
        path: match settings.cull {
            Cull::Distance => CULL_DISTANCE,
            Cull::Frustum => CULL_FRUSTUM,
            Cull::Noise => CULL_NOISE,
            Cull::March => CULL_MARCH,
            Cull::Exact => CULL_EXACT,
            Cull::Hierarchical => CULL_HIERARCHICAL,
        },
        planes: planes(pose, projection),
        start: (f64::from(NEAR_M) * corner * NEAR_ALLOWANCE * FINE).ceil().min(FINE * 64.0) as i32,
        // From below the ground the land is not drawn, so it occludes nothing.
        occlusion_enabled: u32::from(ground > NOWHERE << FINE_BITS && ground < at[1]),
        step: (f64::from(settings.step_m) * FINE) as i32,
        stay: settings.stay,
        corner: grid.corner,
        frame: 0,
        archipelago_seed: noise.map_or(0, |noise| noise.archipelago_seed),
        land_seeds: noise.map_or([0; 16], |noise| land_seeds(&noise)),
        stretch: cache.vertical_scale(),
        reserved: [0; 3],
    }
}

/// The seeds of the fine octaves and of the base field, as a uniform holds them.
fn land_seeds(land: &terrain::Parameters) -> [u32; 16] {
    let mut seeds = [0; 16];
    let all = land.fine_seeds.iter().chain(&land.lattice_seeds);
    seeds.iter_mut().zip(all).for_each(|(word, seed)| *word = *seed);
    seeds
}

/// Inward normals of the four side planes, Q14.
fn planes(pose: &Pose, projection: &Projection) -> [[i32; 4]; 4] {
    let quantised = |normal: DVec3| {
        let [x, y, z] = (normal.normalize_or_zero() * f64::from(1 << 14)).to_array();
        [x.round() as i32, y.round() as i32, z.round() as i32, 0]
    };
    Frustum::new(pose, projection).normals().map(quantised)
}

/// The patches of a species within its range and, unless the method is distance only, inside the
/// frustum; nearest first.
fn patches(grid: &OcclusionGrid, culling: &Culling, planting: &Planting) -> Vec<[i32; 2]> {
    let bits = planting.cell_bits + BLOCK_CELL_BITS + PATCH_BLOCKS.trailing_zeros();
    let side = 1 << bits;
    let count = 1 << (GRID_BITS - bits);
    let places = (0..count).flat_map(|row| (0..count).map(move |column| [column, row]));
    let mut found: Vec<(u32, [i32; 2])> = places
        .filter_map(|[column, row]| {
            let (west, north) = (column << bits, row << bits);
            let nearest =
                [culling.eye[0].clamp(west, west + side), culling.eye[2].clamp(north, north + side)];
            let (top, bottom) = bounds(grid, bits, column, row)?;
            // Roots stand on the drawn land.
            let up = culling.eye[1].clamp(bottom, top);
            let far = distance_squared(culling, nearest[0], up, nearest[1]);
            let half = side / 2;
            let extent = Extent {
                occludee: Occludee {
                    x: west + half,
                    z: north + half,
                    top: top + planting.over,
                    radius: (half >> 5) * 46 + planting.reach,
                    slope_radius: (half >> 5) * 46 + planting.reach,
                    taper: 0,
                    taper_drop: 0,
                    slope_east: 0,
                    slope_south: 0,
                },
                bottom: bottom - planting.reach,
            };
            let is_seen = culling.path == CULL_DISTANCE || may_be_in_view(culling, &extent);
            (far <= planting.draw_distance_squared[0][0] && is_seen).then_some((far, [column, row]))
        })
        .collect();
    found.sort_unstable();
    found.into_iter().map(|(_, patch)| patch).collect()
}

/// Highest and lowest drawn point of a patch, fine units; none without drawn chunks.
fn bounds(grid: &OcclusionGrid, bits: u32, column: i32, row: i32) -> Option<(i32, i32)> {
    let tiles = 1 << (bits - TILE_BITS);
    let side = shaders::layout::GRID_TILES;
    let under = (row * tiles..(row + 1) * tiles)
        .flat_map(|z| (column * tiles..(column + 1) * tiles).map(move |x| (z * side + x) as usize))
        .map(|index| grid.nodes[index])
        .filter(|tile| tile.chunk != shaders::layout::NO_CHUNK);
    under.fold(None, |bounds, tile| {
        let (top, bottom) = bounds.unwrap_or((i32::MIN, i32::MAX));
        Some((top.max(tile.top << FINE_BITS), bottom.min(tile.bottom << FINE_BITS)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_with_fewer_pixels_have_their_detail_nearer() {
        let of = |height, fov_deg, least| {
            detail_scale(&Projection { fov_deg, width: height * 16 / 9, height }, least)
        };
        assert!(of(2160, 60.0, 0.2) == 1.0 && of(720, 60.0, 0.2) == 1.0);
        // 180 lines have half the pixels of 360.
        assert!((of(180, 60.0, 0.2) / of(360, 60.0, 0.2) - 0.5).abs() < 1e-9);
        assert!((of(180, 60.0, 0.2) - 155.9 / FULL_DETAIL_PX).abs() < 1e-3);
        // A longer lens magnifies; the least factor holds.
        assert!(of(180, 20.0, 0.2) > of(180, 60.0, 0.2));
        assert!(of(16, 60.0, 0.2) == 0.2 && of(180, 60.0, LEAST_DETAIL_OF_TREES) == 0.5);
    }

    #[test]
    fn trees_are_known_as_far_as_crowns_have_pixels() {
        let of = |height, fov_deg, range_m| {
            tree_grid_cells(&Projection { fov_deg, width: height * 16 / 9, height }, range_m)
        };
        // 4.5 m are 3 pixels at 1,403 m.
        assert_eq!(of(1080, 60.0, 1500.0), 360);
        assert_eq!(of(540, 60.0, 1500.0), 184);
        // Small images keep 500 m, and no lens needs more room than there is.
        assert_eq!(of(180, 60.0, 1500.0), 128);
        assert_eq!(of(2160, 10.0, 2000.0), 384);
        // No farther than trees stand.
        assert_eq!(of(1080, 60.0, 800.0), 208);
        assert_eq!(of(180, 60.0, 250.0), 72);
        assert!([128, 184, 208, 360, 384].iter().all(|side| side % 8 == 0));
    }

    #[test]
    fn levels_of_detail_begin_nearer_by_the_factor() {
        let grass =
            SpeciesTraits { detail_scale: 0.5, ..SpeciesTraits::grass(&VegetationSettings::STANDARD) };
        let field = grass.field([0; 3], &VegetationSettings::STANDARD);
        assert_eq!(field.lod_m, [5.0, 16.0]);
        // The shader multiplies distances by the inverse.
        assert!(field.detail == 2.0);
    }
}
