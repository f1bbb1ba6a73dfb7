//! Settings of parallax occlusion mapping. Each one is an option, a control of the panel and a word
//! of the uniforms (the tiling: of the objects); the numbers are those of the shaders.

use clap::ValueEnum;
use shaders::layout::PomParams;

/// Settings of parallax occlusion mapping.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PomSettings {
    /// Intersection method.
    pub method: PomMethod,
    /// Steps of the linear search at perpendicular view, 1 to 256.
    pub steps_min: u32,
    /// Steps at grazing view, 1 to 256; interpolated by the view angle.
    pub steps_max: u32,
    /// Refinement of the intersection.
    pub refine: Refine,
    /// Iterations of secant or bisection, 0 to 16.
    pub refinements: u32,
    /// Exit of the search loop.
    pub loop_form: LoopForm,
    /// Height filtering.
    pub heights: Heights,
    /// Self-shadowing.
    pub shadow: PomShadow,
    /// Silhouette.
    pub silhouette: Silhouette,
    /// Whether the displaced surface writes its depth, so that objects intersect it correctly.
    pub depth: bool,
    /// Height that lies on the plane, 0 to 1.
    pub pivot: f32,
    /// Factor of all height ranges, 0 to 16.
    pub amplitude: f32,
    /// Material repeats on the objects of a parallax scene along u and v, relative to the scene's
    /// own; 0.25 to 8. Heights in metres stay, so slopes grow by the same factor. The land has its
    /// own tiling.
    pub tiling: [f32; 2],
    /// Height range on screen below which parallax fades out, pixels, 0 to 16; at half of it, it is
    /// gone. 0: no fade.
    pub fade_px: f32,
    /// Of [`Silhouette::Horizon`].
    pub horizon: Horizon,
}

impl Default for PomSettings {
    fn default() -> Self {
        Self {
            method: PomMethod::Auto,
            steps_min: 8,
            steps_max: 32,
            refine: Refine::Secant,
            refinements: 3,
            loop_form: LoopForm::Exit,
            heights: Heights::Exact,
            shadow: PomShadow::Hard,
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

impl PomSettings {
    /// Most steps of the linear search.
    pub const MAX_STEPS: u32 = 256;
    /// Most refinement iterations.
    pub const MAX_REFINEMENTS: u32 = 16;
    /// Largest amplitude.
    pub const MAX_AMPLITUDE: f32 = 16.0;
    /// Least tiling.
    pub const MIN_TILING: f32 = 0.25;
    /// Most tiling.
    pub const MAX_TILING: f32 = 8.0;
    /// Largest fade height, pixels.
    pub const MAX_FADE_PX: f32 = 16.0;
    /// Texels of ray travel up to which the automatic method is flat, single-offset and linear:
    /// where the curves of `tombolo-lab accuracy --only pom` cross.
    pub const TRAVELS: [f32; 3] = [0.5, 2.0, 4.0];

    /// The settings clamped to their ranges; NaN becomes the default. The shaders rely on it.
    #[must_use]
    pub fn sanitized(self) -> Self {
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
            horizon: self.horizon.sanitized(),
            ..self
        }
    }

    /// Fade factor of a height range of this many pixels on screen. The shaders compute the same.
    #[must_use]
    pub fn fade(self, height_px: f32) -> f32 {
        let fade_px = self.sanitized().fade_px;
        if fade_px <= 0.0 {
            return 1.0;
        }
        let part = ((height_px / fade_px - 0.5) / 0.5).clamp(0.0, 1.0);
        part * part * (3.0 - 2.0 * part)
    }

    /// Shader parameters.
    #[must_use]
    pub fn layout(self) -> PomParams {
        let settings = self.sanitized();
        let [travel_flat, travel_offset, travel_linear] = Self::TRAVELS;
        let Horizon { strength, height_bias, safe_threshold, falloff } = settings.horizon;
        PomParams {
            tier: settings.method as u32,
            steps_min: settings.steps_min,
            steps_max: settings.steps_max,
            refine: settings.refine as u32,
            refinements: settings.refinements,
            loop_form: settings.loop_form as u32,
            heights: settings.heights as u32,
            shadow: settings.shadow as u32,
            silhouette: settings.silhouette as u32,
            depth: settings.depth.into(),
            pivot: settings.pivot,
            amplitude: settings.amplitude,
            horizon: [strength, height_bias, safe_threshold, falloff],
            travel_flat,
            travel_offset,
            travel_linear,
            fade_px: settings.fade_px,
        }
    }
}

/// Horizon silhouette: erosion of a curved surface at grazing view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Horizon {
    /// Strength, 0 to 4.
    pub strength: f32,
    /// Subtracted from heights before the comparison, 0 to 1.
    pub height_bias: f32,
    /// Cosine of the view angle above which nothing is cut, 0 to 0.95.
    pub safe_threshold: f32,
    /// Falloff power, 0.5 to 8: higher is later.
    pub falloff: f32,
}

impl Default for Horizon {
    fn default() -> Self {
        Self { strength: 1.0, height_bias: 0.0, safe_threshold: 0.3, falloff: 2.0 }
    }
}

impl Horizon {
    fn sanitized(self) -> Self {
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

/// Intersection method, cheapest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum PomMethod {
    /// None: a flat texture.
    Flat,
    /// Parallax mapping: one offset by the height at the plane.
    Offset,
    /// Linear search with refinement.
    Linear,
    /// Relaxed cone stepping with bisection; cones are baked on first use in a parallax scene. The
    /// land has none and uses `pyramid`.
    Cones,
    /// Maximum-mipmap traversal: exact.
    #[value(name = "pyramid", alias = "max-mip")]
    MaxMip,
    /// The cheapest method that is accurate for the ray's travel.
    #[default]
    Auto,
}

/// Refinement of the interval that the linear search found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Refine {
    /// Not at all.
    None,
    /// Linear interpolation in the interval.
    Segment,
    /// Secant iterations (false position).
    #[default]
    Secant,
    /// Bisection.
    Bisection,
}

/// Exit of the search loop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LoopForm {
    /// Break at the crossing.
    #[default]
    Exit,
    /// Run all steps, with a done flag.
    Flag,
}

/// Height interpolation between texels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Heights {
    /// Hardware sampler, 8 fraction bits.
    Sampler,
    /// Bilinear in f32 from four texels.
    #[default]
    Exact,
}

/// Self-shadowing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum PomShadow {
    /// None.
    Off,
    /// Maximum-mipmap traversal towards the sun.
    #[default]
    Hard,
    /// Seven taps towards the sun: soft, and misses narrow features.
    Soft,
}

/// Silhouette of a displaced surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Silhouette {
    /// None: the edge of the mesh.
    #[default]
    None,
    /// Cut where the ray leaves the rectangle of the material.
    Rectangle,
    /// Eroded towards the edge of a curved surface.
    Horizon,
    /// A shell of the full height, cut where no ray hits.
    Shell,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_held_in_range_and_what_is_no_number_is_the_default() {
        let odd = |value: f32, steps: u32| {
            let horizon =
                Horizon { strength: value, height_bias: value, safe_threshold: value, falloff: value };
            let settings = PomSettings {
                steps_min: steps,
                steps_max: steps,
                refinements: steps,
                pivot: value,
                amplitude: value,
                tiling: [value, 2.0],
                fade_px: value,
                horizon,
                ..PomSettings::default()
            };
            settings.sanitized()
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
        assert_eq!(PomSettings::default().sanitized(), PomSettings::default());
        assert_eq!([not_a_number, high, low].map(|settings| settings.fade_px), [1.0, 16.0, 0.0]);
        assert_eq!(
            [not_a_number, high, low].map(|settings| settings.tiling),
            [[1.0, 2.0], [8.0, 2.0], [0.25, 2.0]]
        );
        let crossed = PomSettings { steps_min: 64, steps_max: 4, ..PomSettings::default() }.sanitized();
        assert_eq!((crossed.steps_min, crossed.steps_max), (4, 4));
    }

    #[test]
    fn a_relief_sinks_from_the_fade_to_half_of_it_and_without_a_fade_it_stays() {
        let settings = PomSettings { fade_px: 4.0, ..PomSettings::default() };
        assert_eq!([0.0, 1.9, 2.0, 4.0, 99.0].map(|height| settings.fade(height)), [0.0, 0.0, 0.0, 1.0, 1.0]);
        let between = [2.2, 2.8, 3.4, 3.9].map(|height| settings.fade(height));
        assert!(between.is_sorted() && between[0] > 0.0 && between[3] < 1.0, "{between:?}");
        assert_eq!(PomSettings { fade_px: 0.0, ..settings }.fade(0.0), 1.0);
    }
}
