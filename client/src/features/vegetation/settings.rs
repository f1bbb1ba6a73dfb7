//! Vegetation settings.

use clap::ValueEnum;
use shaders::layout::GRASS_RANGE_M;

/// Share of the view distance that carries plants: the land beyond is dissolved.
pub const REACHED: f64 = 0.8;

/// Culling method. All keep the range, and all but the first the frustum; the last two remove the
/// same clumps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Cull {
    /// All within their range (T0).
    Distance,
    /// Plus a frustum test (T1).
    Frustum,
    /// Plus a ray march over the noise between vertices (T2). Inexact: drops visible plants
    Noise,
    /// Plus a ray march over the drawn vertices, with five points per chunk. Inexact: drops visible
    /// plants
    March,
    /// Plus a conservative test against the drawn triangles, which drops no visible plant (T3)
    Exact,
    /// The same, hierarchical: whole blocks first (T4)
    #[default]
    Hierarchical,
}

/// Whether trees cast shadows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum PlantShadows {
    /// No shadows.
    Off,
    /// On the ground, on grass and on each other.
    #[default]
    On,
}

/// Vegetation settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VegetationSettings {
    /// Clumps of grass on a cell of 2 x 2 m where it is densest, 0 to
    /// [`VegetationSettings::MAX_DENSITY`]; 0 for none.
    pub density: u32,
    /// Range of grass, metres, 0 to [`VegetationSettings::MAX_RANGE_M`].
    pub range_m: f32,
    /// Full density up to here, metres; beyond, fewer and wider clumps.
    pub thin_from_m: f32,
    /// Largest factor of a clump's width.
    pub widest: f32,
    /// Trees on a cell of 8 x 8 m at most, 0 to 4; 0 for none.
    pub trees: u32,
    /// Range of trees, metres, 0 to [`VegetationSettings::MAX_TREE_RANGE_M`].
    pub tree_range_m: f32,
    /// Up to here each tree is culled by itself, metres; farther ones by patches, and thinned.
    pub single_trees_m: f32,
    /// Up to here trees have sprays of leaves, metres, in images of full detail; farther ones are
    /// impostors.
    pub impostors_from_m: f32,
    /// Culling method.
    pub cull: Cull,
    /// Frames for which a block stays visible after its last visible frame, 0 to 60. Exact tests
    /// need none.
    pub stay: u32,
    /// Step of the marches, metres, 0.25 to 16.
    pub step_m: f32,
    /// Wind, 0 to 1.
    pub wind: f32,
    /// How far clumps lean away from an eye above them, 0 to 1.
    pub lean: f32,
    /// Whether trees cast shadows on the ground, on grass and on each other.
    pub shadows: PlantShadows,
}

impl VegetationSettings {
    /// Most clumps of a cell.
    pub const MAX_DENSITY: u32 = 32;
    /// Farthest tree, metres.
    pub const MAX_TREE_RANGE_M: f32 = 8000.0;
    /// Farthest plant that is culled by itself, metres.
    pub const MAX_RANGE_M: f32 = super::occlusion_grid::REACH_M as f32;
    /// Most trees of a cell.
    pub const MAX_TREES: u32 = 4;
    /// No plants.
    pub const NONE: Self = Self { density: 0, trees: 0, ..Self::STANDARD };
    /// A meadow with groves: dense near the eye, thinned so that a blade stays wider than 1/600 of
    /// the image height.
    pub const STANDARD: Self = Self {
        density: 32,
        range_m: 260.0,
        thin_from_m: 42.0,
        widest: 6.0,
        trees: 1,
        tree_range_m: 1500.0,
        single_trees_m: 1500.0,
        impostors_from_m: 220.0,
        cull: Cull::Hierarchical,
        stay: 0,
        step_m: 2.0,
        wind: 0.4,
        lean: 0.6,
        shadows: PlantShadows::On,
    };
    /// Fewer and nearer, so that the land is visible.
    pub const SPARSE: Self =
        Self { density: 8, range_m: 240.0, thin_from_m: 80.0, widest: 4.0, ..Self::STANDARD };

    /// Whether there are any plants.
    #[must_use]
    pub fn any(&self) -> bool {
        self.density > 0 || self.trees > 0
    }

    /// Range and density of the grass, as the land shader has them in [`shaders::layout::Frame`].
    #[must_use]
    pub fn packed_grass(&self, view_distance_m: u32) -> u32 {
        let fraction = |share: f32| (65_535.0 * share.clamp(0.0, 1.0)).round() as u32;
        let range_m = self.range_m.min((REACHED * f64::from(view_distance_m)) as f32);
        let density = self.density as f32 / Self::MAX_DENSITY as f32;
        fraction(range_m / GRASS_RANGE_M) | fraction(density) << 16
    }

    /// The settings clamped to their ranges; NaN becomes the standard.
    #[must_use]
    pub fn sanitized(self) -> Self {
        let standard = Self::STANDARD;
        let within = |value: f32, low: f32, high: f32, standard: f32| {
            if value.is_nan() { standard } else { value.clamp(low, high) }
        };
        Self {
            density: self.density.min(Self::MAX_DENSITY),
            range_m: within(self.range_m, 0.0, Self::MAX_RANGE_M, standard.range_m),
            thin_from_m: within(self.thin_from_m, 1.0, Self::MAX_RANGE_M, standard.thin_from_m),
            widest: within(self.widest, 1.0, 16.0, standard.widest),
            trees: self.trees.min(Self::MAX_TREES),
            tree_range_m: within(self.tree_range_m, 0.0, Self::MAX_TREE_RANGE_M, standard.tree_range_m),
            single_trees_m: within(self.single_trees_m, 0.0, Self::MAX_RANGE_M, standard.single_trees_m),
            impostors_from_m: within(
                self.impostors_from_m,
                0.0,
                Self::MAX_RANGE_M,
                standard.impostors_from_m,
            ),
            cull: self.cull,
            stay: self.stay.min(60),
            step_m: within(self.step_m, 0.25, 16.0, standard.step_m),
            wind: within(self.wind, 0.0, 1.0, standard.wind),
            lean: within(self.lean, 0.0, 1.0, standard.lean),
            shadows: self.shadows,
        }
    }
}

impl Default for VegetationSettings {
    fn default() -> Self {
        Self::NONE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frame_holds_range_and_density_of_the_grass() {
        let of = |density, range_m, view_distance_m| {
            let packed = VegetationSettings { density, range_m, ..VegetationSettings::STANDARD }
                .packed_grass(view_distance_m);
            [(packed & 0xffff) as f32 / 65_535.0 * GRASS_RANGE_M, (packed >> 16) as f32 / 65_535.0]
        };
        let [range_m, density] = of(16, 260.0, 8000);
        assert!((range_m - 260.0).abs() < 0.05 && (density - 0.5).abs() < 1e-4, "{range_m} {density}");
        // No farther than the land is seen; none without grass.
        assert!((of(16, 260.0, 100)[0] - 80.0).abs() < 0.05);
        assert!(of(0, 260.0, 8000)[1] == 0.0);
        // The control: half the density is not the whole.
        assert!(of(32, 260.0, 8000)[1] > 1.9 * density);
    }
}
