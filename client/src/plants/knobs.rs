//! What a person can choose about plants.

use clap::ValueEnum;

/// How it is decided which plants are drawn. Each one leaves out what the one before it does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Cull {
    /// All within their distance (T0).
    Distance,
    /// Of those, what is inside the view (T1).
    Frustum,
    /// Of those, what a march over the noise between vertices does not find hidden (T2). Loses what
    /// is seen
    Noise,
    /// Of those, what a march over the drawn vertices does not find hidden; chunks by five points
    /// (T3 as first published). Loses what is seen
    March,
    /// Of those, what the drawn triangles do not provably hide (T3)
    Exact,
    /// The same, whole blocks first (T4)
    #[default]
    Hierarchical,
}

/// Knobs of plants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantKnobs {
    /// Clumps of grass on a cell of 2 x 2 m where it is densest, 0 to [`PlantKnobs::MAX_DENSITY`];
    /// 0 for none.
    pub density: u32,
    /// Grass stands up to here, metres, 0 to [`PlantKnobs::MAX_RANGE_M`].
    pub range_m: f32,
    /// All of it stands up to here, metres; beyond, fewer and wider.
    pub thin_from_m: f32,
    /// Most that a clump is widened.
    pub widest: f32,
    /// Trees on a cell of 8 x 8 m at most, 0 to 4; 0 for none.
    pub trees: u32,
    /// Trees stand up to here, metres.
    pub tree_range_m: f32,
    /// How it is decided what is drawn.
    pub cull: Cull,
    /// Frames for which a block stays after it was last seen, 0 to 60. An exact test needs none.
    pub stay: u32,
    /// Step of the marches, metres, 0.25 to 16.
    pub step_m: f32,
    /// Wind, 0 to 1.
    pub wind: f32,
    /// How far clumps lean away from an eye above them, 0 to 1.
    pub lean: f32,
}

impl PlantKnobs {
    /// Most clumps of a cell.
    pub const MAX_DENSITY: u32 = 32;
    /// Farthest plant, metres.
    pub const MAX_RANGE_M: f32 = super::square::REACH_M as f32;
    /// Most trees of a cell.
    pub const MAX_TREES: u32 = 4;
    /// No plants.
    pub const NONE: Self = Self { density: 0, trees: 0, ..Self::STANDARD };
    /// A meadow with groves: dense at the feet, and from there on thinned so that a blade stays
    /// wider than a pixel of 1/600.
    pub const STANDARD: Self = Self {
        density: 32,
        range_m: 260.0,
        thin_from_m: 42.0,
        widest: 6.0,
        trees: 1,
        tree_range_m: 1500.0,
        cull: Cull::Hierarchical,
        stay: 0,
        step_m: 2.0,
        wind: 0.4,
        lean: 0.6,
    };
    /// Fewer and nearer, so that the land shows.
    pub const SPARSE: Self =
        Self { density: 8, range_m: 240.0, thin_from_m: 80.0, widest: 4.0, ..Self::STANDARD };

    /// Whether anything grows.
    #[must_use]
    pub fn any(&self) -> bool {
        self.density > 0 || self.trees > 0
    }

    /// The knobs within their ranges; what is no number becomes the standard.
    #[must_use]
    pub fn sane(self) -> Self {
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
            tree_range_m: within(self.tree_range_m, 0.0, Self::MAX_RANGE_M, standard.tree_range_m),
            cull: self.cull,
            stay: self.stay.min(60),
            step_m: within(self.step_m, 0.25, 16.0, standard.step_m),
            wind: within(self.wind, 0.0, 1.0, standard.wind),
            lean: within(self.lean, 0.0, 1.0, standard.lean),
        }
    }
}

impl Default for PlantKnobs {
    fn default() -> Self {
        Self::NONE
    }
}
