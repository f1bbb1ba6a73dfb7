//! Knobs of parallax occlusion mapping. Each one is an option, a control of the panel and a word in
//! the uniforms (the tiling: of the objects); their numbers are those of `shared/relief.wesl`.

use clap::ValueEnum;
use shaders::layout::Relief;

/// How reliefs are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReliefKnobs {
    /// How a ray's meeting with the relief is found.
    pub tier: ReliefTier,
    /// Steps of the linear search looking straight down, 1 to 256.
    pub steps_min: u32,
    /// The same along the plane; between both by the view's angle.
    pub steps_max: u32,
    /// How its crossing is refined.
    pub refine: Refine,
    /// Rounds of secant or bisection, 0 to 16.
    pub refinements: u32,
    /// How its loop ends.
    pub loop_form: LoopForm,
    /// How heights are filtered.
    pub heights: Heights,
    /// Shadow of the relief on itself.
    pub shadow: ReliefShadow,
    /// How the edge of what is drawn follows the relief.
    pub silhouette: Silhouette,
    /// Whether the relief has its own depth, so that objects meet it where it is.
    pub depth: bool,
    /// Height that lies on the plane, 0 to 1.
    pub pivot: f32,
    /// Multiplies the relief of every material, 0 to 16.
    pub amplitude: f32,
    /// How often materials repeat on the objects of a scene of reliefs, along u and v, over the
    /// scene's own; 0.25 to 8. Heights stay as many metres as they are, so the relief becomes as
    /// many times steeper. The land has a tiling of its own.
    pub tiling: [f32; 2],
    /// Height of a relief on screen at which it begins to sink, pixels, 0 to 16; at half of that it
    /// is gone. 0: it never sinks.
    pub fade_px: f32,
    /// Of [`Silhouette::Horizon`].
    pub horizon: Horizon,
}

impl Default for ReliefKnobs {
    fn default() -> Self {
        Self {
            tier: ReliefTier::Auto,
            steps_min: 8,
            steps_max: 32,
            refine: Refine::Secant,
            refinements: 3,
            loop_form: LoopForm::Exit,
            heights: Heights::Exact,
            shadow: ReliefShadow::Hard,
            silhouette: Silhouette::None,
            depth: false,
            pivot: 0.5,
            amplitude: 1.0,
            tiling: [1.0; 2],
            fade_px: 1.0,
            horizon: Horizon::default(),
        }
    }
}

impl ReliefKnobs {
    /// Most steps of the linear search.
    pub const MAX_STEPS: u32 = 256;
    /// Most rounds of refinement.
    pub const MAX_REFINEMENTS: u32 = 16;
    /// Largest amplitude.
    pub const MAX_AMPLITUDE: f32 = 16.0;
    /// Least tiling.
    pub const MIN_TILING: f32 = 0.25;
    /// Most tiling.
    pub const MAX_TILING: f32 = 8.0;
    /// Latest fade, pixels.
    pub const MAX_FADE_PX: f32 = 16.0;
    /// Texels of travel up to which the automatic tier displaces nothing, takes one offset, and
    /// searches linearly: where the curves of `tombolo-lab accuracy --only pom` cross.
    pub const TRAVELS: [f32; 3] = [0.5, 2.0, 4.0];

    /// The knobs within their ranges; what is no number becomes the default. The shaders rely on
    /// it.
    #[must_use]
    pub fn sane(self) -> Self {
        let standard = Self::default();
        let within = |value: f32, high: f32, standard: f32| {
            if value.is_nan() { standard } else { value.clamp(0.0, high) }
        };
        let steps_max = self.steps_max.clamp(1, Self::MAX_STEPS);
        Self {
            steps_min: self.steps_min.clamp(1, steps_max),
            steps_max,
            refinements: self.refinements.min(Self::MAX_REFINEMENTS),
            pivot: within(self.pivot, 1.0, standard.pivot),
            amplitude: within(self.amplitude, Self::MAX_AMPLITUDE, standard.amplitude),
            tiling: self.tiling.map(|tiling| {
                if tiling.is_nan() { 1.0 } else { tiling.clamp(Self::MIN_TILING, Self::MAX_TILING) }
            }),
            fade_px: within(self.fade_px, Self::MAX_FADE_PX, standard.fade_px),
            horizon: self.horizon.sane(),
            ..self
        }
    }

    /// Share that is left of a relief that is so many pixels high on screen. Twin: `relief_left` in
    /// `shared/relief.wesl`.
    #[must_use]
    pub fn left(self, height_px: f32) -> f32 {
        let fade_px = self.sane().fade_px;
        if fade_px <= 0.0 {
            return 1.0;
        }
        let part = ((height_px / fade_px - 0.5) / 0.5).clamp(0.0, 1.0);
        part * part * (3.0 - 2.0 * part)
    }

    /// As the shaders read them.
    #[must_use]
    pub fn layout(self) -> Relief {
        let knobs = self.sane();
        let [travel_flat, travel_offset, travel_linear] = Self::TRAVELS;
        let Horizon { strength, height_bias, safe_threshold, falloff } = knobs.horizon;
        Relief {
            tier: knobs.tier as u32,
            steps_min: knobs.steps_min,
            steps_max: knobs.steps_max,
            refine: knobs.refine as u32,
            refinements: knobs.refinements,
            loop_form: knobs.loop_form as u32,
            heights: knobs.heights as u32,
            shadow: knobs.shadow as u32,
            silhouette: knobs.silhouette as u32,
            depth: knobs.depth.into(),
            pivot: knobs.pivot,
            amplitude: knobs.amplitude,
            horizon: [strength, height_bias, safe_threshold, falloff],
            travel_flat,
            travel_offset,
            travel_linear,
            fade_px: knobs.fade_px,
        }
    }
}

/// Erosion of a curved surface's edge, by how nearly it is seen from the side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Horizon {
    /// How much is cut, 0 to 4.
    pub strength: f32,
    /// Taken off heights before they are compared, 0 to 1.
    pub height_bias: f32,
    /// Cosine of the view's angle above which nothing is cut, 0 to 0.95.
    pub safe_threshold: f32,
    /// How fast the cut sets in, 0.5 to 8: higher is later.
    pub falloff: f32,
}

impl Default for Horizon {
    fn default() -> Self {
        Self { strength: 1.0, height_bias: 0.0, safe_threshold: 0.3, falloff: 2.0 }
    }
}

impl Horizon {
    fn sane(self) -> Self {
        let standard = Self::default();
        let within = |value: f32, low: f32, high: f32, standard: f32| {
            if value.is_nan() { standard } else { value.clamp(low, high) }
        };
        Self {
            strength: within(self.strength, 0.0, 4.0, standard.strength),
            height_bias: within(self.height_bias, 0.0, 1.0, standard.height_bias),
            safe_threshold: within(self.safe_threshold, 0.0, 0.95, standard.safe_threshold),
            falloff: within(self.falloff, 0.5, 8.0, standard.falloff),
        }
    }
}

/// How a ray's meeting with a relief is found, cheapest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ReliefTier {
    /// Not at all: a picture on a plane.
    Flat,
    /// One offset by the height at the plane.
    Offset,
    /// Steps of one length and a refinement.
    Linear,
    /// Relaxed cones and halving; baked for a scene of reliefs when it is first asked for. The land
    /// has none and is drawn by the pyramid.
    Cones,
    /// The exact walk over the max pyramid.
    Pyramid,
    /// The cheapest that is good enough for how far the ray travels.
    #[default]
    Auto,
}

/// How the crossing that a linear search brackets is refined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Refine {
    /// Not at all.
    None,
    /// The point on the chord.
    Segment,
    /// False position.
    #[default]
    Secant,
    /// Halving.
    Bisection,
}

/// How the loop of a linear search ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LoopForm {
    /// At the crossing.
    #[default]
    Exit,
    /// After all steps, with a flag for being done.
    Flag,
}

/// How heights between texels are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Heights {
    /// By the sampler, which knows 256 places between two texels.
    Sampler,
    /// From four texels in f32.
    #[default]
    Exact,
}

/// Shadow of a relief on itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ReliefShadow {
    /// None.
    Off,
    /// The exact walk towards the sun.
    #[default]
    Hard,
    /// Seven taps towards the sun: blurred, and blind to what is narrow.
    Soft,
}

/// How the edge of what is drawn follows its relief.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Silhouette {
    /// Not: the edge of the plane.
    #[default]
    None,
    /// Where the ray leaves the rectangle of the material.
    Rectangle,
    /// Eroded towards the edge of a curved surface.
    Horizon,
    /// A shell as high as the relief, cut where no ray meets it.
    Shell,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knobs_are_held_in_range_and_what_is_no_number_is_the_default() {
        let odd = |value: f32, steps: u32| {
            let horizon =
                Horizon { strength: value, height_bias: value, safe_threshold: value, falloff: value };
            let knobs = ReliefKnobs {
                steps_min: steps,
                steps_max: steps,
                refinements: steps,
                pivot: value,
                amplitude: value,
                tiling: [value, 2.0],
                fade_px: value,
                horizon,
                ..ReliefKnobs::default()
            };
            knobs.sane()
        };
        let not_a_number = odd(f32::NAN, 9);
        assert_eq!((not_a_number.pivot, not_a_number.amplitude), (0.5, 1.0));
        assert_eq!(not_a_number.horizon, Horizon::default());
        let high = odd(f32::INFINITY, u32::MAX);
        assert_eq!(
            (high.steps_min, high.steps_max, high.refinements, high.pivot, high.amplitude),
            (256, 256, 16, 1.0, 16.0)
        );
        let low = odd(-1e30, 0);
        assert_eq!((low.steps_min, low.steps_max, low.pivot, low.amplitude), (1, 1, 0.0, 0.0));
        assert_eq!((low.horizon.falloff, high.horizon.safe_threshold), (0.5, 0.95));
        assert_eq!(ReliefKnobs::default().sane(), ReliefKnobs::default());
        assert_eq!([not_a_number, high, low].map(|knobs| knobs.fade_px), [1.0, 16.0, 0.0]);
        assert_eq!(
            [not_a_number, high, low].map(|knobs| knobs.tiling),
            [[1.0, 2.0], [8.0, 2.0], [0.25, 2.0]]
        );
        let crossed = ReliefKnobs { steps_min: 64, steps_max: 4, ..ReliefKnobs::default() }.sane();
        assert_eq!((crossed.steps_min, crossed.steps_max), (4, 4));
    }

    #[test]
    fn a_relief_sinks_from_the_fade_to_half_of_it_and_without_a_fade_it_stays() {
        let knobs = ReliefKnobs { fade_px: 4.0, ..ReliefKnobs::default() };
        assert_eq!([0.0, 1.9, 2.0, 4.0, 99.0].map(|height| knobs.left(height)), [0.0, 0.0, 0.0, 1.0, 1.0]);
        let between = [2.2, 2.8, 3.4, 3.9].map(|height| knobs.left(height));
        assert!(between.is_sorted() && between[0] > 0.0 && between[3] < 1.0, "{between:?}");
        assert_eq!(ReliefKnobs { fade_px: 0.0, ..knobs }.left(0.0), 1.0);
    }
}
