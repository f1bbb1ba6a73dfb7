//! Groups of settings in the panel, with the names of the options.

use super::clock::Day;
use super::view_settings::ViewSettings;
use crate::features::pom::PomSettings;
use crate::features::pom::settings::{Heights, LoopForm, PomMethod, PomShadow, Refine, Silhouette};
use crate::features::post::{Antialias, PostSettings, Tone};
use crate::features::vegetation::{Cull, VegetationSettings};
use crate::features::water::WaterTier;
use crate::settings::{Diffuse, RenderSettings, Shadows, Show, SunPosition, Tiling, Visibility};
use clap::ValueEnum;
use egui::{Slider, SliderClamping, Ui};

/// Light, water and what is shown.
pub fn image(ui: &mut Ui, settings: &mut ViewSettings, scene_sun: SunPosition) {
    let ViewSettings { render, day, .. } = settings;
    egui::Grid::new("picture").num_columns(2).show(ui, |ui| {
        choice::<Show>(ui, "show", "Final image or a debug view", &mut render.show);
        sun(ui, &mut render.sun, day, scene_sun);
        let exposure = Slider::new(&mut render.exposure_ev, -8.0..=8.0).suffix(" EV");
        row(ui, "exposure", "Stops brighter or darker than the scene", exposure);
        choice::<Shadows>(ui, "shadows", "Terrain self-shadowing", &mut render.shadows);
        choice::<Tiling>(ui, "tiling", "Method against visible texture repetition", &mut render.tiling);
        choice::<WaterTier>(ui, "water", "How the depth of waves is found", &mut render.water);
        let steepness = Slider::new(&mut render.waves.steepness, 0.0..=4.0);
        row(ui, "steepness", "Wave steepness; 1 is a fresh breeze", steepness);
    });
}

/// Direction of the sun: by the time of day, or by its angles.
fn sun(ui: &mut Ui, sun: &mut Option<SunPosition>, day: &mut Day, scene_sun: SunPosition) {
    ui.label("time of day").on_hover_text("Moves the sun along its path of a day in May at 28 degrees north");
    ui.horizontal(|ui| {
        let hours = Slider::new(&mut day.hours, 0.0..=24.0).suffix(" h").max_decimals(1);
        if ui.add(hours.clamping(SliderClamping::Edits)).changed() {
            *sun = Some(SunPosition::at_hour(day.hours));
        }
        ui.checkbox(&mut day.plays, "play").on_hover_text("An hour in four seconds; Space stops it");
    });
    ui.end_row();
    let mut place = sun.unwrap_or(scene_sun);
    let azimuth = Slider::new(&mut place.azimuth_deg, 0.0..=360.0).suffix("°");
    let azimuth = row(ui, "azimuth", "Sun azimuth, clockwise from north", azimuth);
    let elevation = Slider::new(&mut place.elevation_deg, -90.0..=90.0).suffix("°");
    let elevation = row(ui, "elevation", "Sun elevation above the horizon", elevation);
    if azimuth || elevation {
        (*sun, *day) = (Some(place), Day::nearest_to(place));
    }
    if sun.is_some() {
        ui.label("");
        if ui.small_button("sun of the scene").clicked() {
            (*sun, *day) = (None, Day::nearest_to(scene_sun));
        }
        ui.end_row();
    }
}

/// From linear light to the image.
pub fn post(ui: &mut Ui, settings: &mut PostSettings) {
    egui::Grid::new("post").num_columns(2).show(ui, |ui| {
        choice::<Tone>(ui, "tone", "Curve from light to colours", &mut settings.tone);
        ui.label("exposure").on_hover_text("Follows the mean light of the picture, within limits");
        ui.checkbox(&mut settings.auto_exposure, "automatic");
        ui.end_row();
        let bloom = Slider::new(&mut settings.bloom, 0.0..=1.0);
        row(ui, "bloom", "Light that spreads around bright places", bloom);
        choice::<Antialias>(ui, "antialias", "Edge filter; for one sample a pixel", &mut settings.antialias);
        row(ui, "sharpen", "0 is off", Slider::new(&mut settings.sharpen, 0.0..=1.0));
        let scales = PostSettings::MIN_SCALE..=PostSettings::MAX_SCALE;
        let scale = Slider::new(&mut settings.render_scale, scales).step_by(0.05);
        row(ui, "render scale", "Rendered size over the size of the window", scale);
    });
}

/// Density and range of plants.
pub fn vegetation(ui: &mut Ui, settings: &mut VegetationSettings) {
    egui::Grid::new("plants").num_columns(2).show(ui, |ui| {
        let density = Slider::new(&mut settings.density, 0..=VegetationSettings::MAX_DENSITY);
        row(ui, "grass", "Clumps on 2 x 2 m where it is densest; 0 for none", density);
        let range = Slider::new(&mut settings.range_m, 0.0..=1000.0).suffix(" m");
        row(ui, "range", "Distance up to which grass stands", range);
        let thin_from = Slider::new(&mut settings.thin_from_m, 1.0..=400.0).logarithmic(true).suffix(" m");
        row(ui, "thin from", "Beyond it fewer and wider clumps", thin_from);
        row(ui, "widest", "Largest widening of far clumps", Slider::new(&mut settings.widest, 1.0..=16.0));
        let trees = Slider::new(&mut settings.trees, 0..=VegetationSettings::MAX_TREES);
        row(ui, "trees", "On 8 x 8 m of wood at most; 0 for none", trees);
        let farthest = 0.0..=VegetationSettings::MAX_TREE_RANGE_M;
        let tree_range = Slider::new(&mut settings.tree_range_m, farthest).suffix(" m");
        row(ui, "tree range", "Distance up to which trees stand", tree_range);
        row(ui, "wind", "0 is calm", Slider::new(&mut settings.wind, 0.0..=1.0));
        row(ui, "lean", "Grass lean away from an eye above it", Slider::new(&mut settings.lean, 0.0..=1.0));
    });
}

/// Relief of materials. Changing a setting never builds a pipeline; selecting `cones` bakes the
/// cone map once.
pub fn pom(ui: &mut Ui, settings: &mut PomSettings, has_land: bool) {
    egui::Grid::new("relief").num_columns(2).show(ui, |ui| {
        choice::<PomMethod>(ui, "relief", "How the depth of materials is found", &mut settings.method);
        if settings.method == PomMethod::Cones && has_land {
            ui.label("");
            ui.label("no cone maps for terrain; using maximum-mipmap traversal");
            ui.end_row();
        }
        choice::<PomShadow>(ui, "shadow", "Relief self-shadowing", &mut settings.shadow);
        let amplitude = Slider::new(&mut settings.amplitude, 0.0..=PomSettings::MAX_AMPLITUDE);
        row(ui, "amplitude", "Factor of all height ranges", amplitude);
        let fade = Slider::new(&mut settings.fade_px, 0.0..=PomSettings::MAX_FADE_PX).suffix(" px");
        row(ui, "fade below", "Height on screen below which a relief fades out", fade);
        if !has_land {
            let tiling = PomSettings::MIN_TILING..=PomSettings::MAX_TILING;
            let [u, v] = &mut settings.tiling;
            row(ui, "tiling along u", "Repeats", Slider::new(u, tiling.clone()).logarithmic(true));
            row(ui, "tiling along v", "Repeats", Slider::new(v, tiling).logarithmic(true));
        }
        choice::<Silhouette>(ui, "silhouette", "Outline of displaced objects", &mut settings.silhouette);
    });
}

/// Settings for comparisons of methods: forms of loops, terms of the light, reference methods.
pub fn laboratory(ui: &mut Ui, settings: &mut RenderSettings, has_land: bool) {
    egui::Grid::new("laboratory").num_columns(2).show(ui, |ui| {
        choice::<Diffuse>(ui, "diffuse", "Model of diffuse reflection", &mut settings.diffuse);
        choice::<Visibility>(ui, "visibility", "Term of specular reflection", &mut settings.visibility);
        let waves = &mut settings.waves;
        let factor = Slider::new(&mut waves.parallax_factor, 0.0..=1.0);
        row(ui, "wave depth", "--parallax-factor: 0 is flat, 0.2 the true height", factor);
        let bias = Slider::new(&mut waves.parallax_bias_m, -2.0..=2.0).suffix(" m");
        row(ui, "water bias", "--parallax-bias: offset of the water surface", bias);
        let pom = &mut settings.pom;
        let steps = 1..=PomSettings::MAX_STEPS;
        let least = Slider::new(&mut pom.steps_min, steps.clone()).logarithmic(true);
        row(ui, "min steps (view along normal)", "Least steps of the linear search", least);
        let most = Slider::new(&mut pom.steps_max, steps).logarithmic(true);
        row(ui, "max steps (grazing view)", "Most steps of the linear search", most);
        choice::<Refine>(ui, "refine", "Refinement of the intersection", &mut pom.refine);
        let rounds = Slider::new(&mut pom.refinements, 0..=PomSettings::MAX_REFINEMENTS);
        row(ui, "refinements", "Iterations", rounds);
        choice::<LoopForm>(ui, "loop", "How the search ends", &mut pom.loop_form);
        choice::<Heights>(ui, "heights", "Interpolation between texels", &mut pom.heights);
        row(ui, "pivot", "Height that lies on the plane", Slider::new(&mut pom.pivot, 0.0..=1.0));
        ui.label("depth").on_hover_text("Writes the relief to the depth buffer");
        ui.checkbox(&mut pom.depth, "displaced");
        ui.end_row();
        let horizon = &mut pom.horizon;
        row(ui, "horizon", "Horizon silhouette: strength", Slider::new(&mut horizon.strength, 0.0..=4.0));
        let bias = Slider::new(&mut horizon.height_bias, 0.0..=1.0);
        row(ui, "height bias", "Horizon silhouette: offset of the height", bias);
        let threshold = Slider::new(&mut horizon.safe_threshold, 0.0..=0.95);
        let hint = "Horizon silhouette: cosine of the view angle above which nothing is clipped";
        row(ui, "safe threshold", hint, threshold);
        let falloff = Slider::new(&mut horizon.falloff, 0.5..=8.0);
        row(ui, "falloff", "Horizon silhouette: exponent of the falloff", falloff);
        if has_land {
            let plants = &mut settings.plants;
            choice::<Cull>(ui, "cull", "Visibility test of plants", &mut plants.cull);
            let hysteresis = Slider::new(&mut plants.stay, 0..=60).suffix(" frames");
            row(ui, "hysteresis", "How long plants stay drawn after they were visible", hysteresis);
            let step = Slider::new(&mut plants.step_m, 0.25..=16.0).logarithmic(true).suffix(" m");
            row(ui, "step", "Step length of --cull noise and march", step);
        }
    });
}

/// A row with a slider; whether the user moved it. A setting between its steps or beyond its ends
/// stays until then.
fn row(ui: &mut Ui, name: &str, hint: &str, slider: Slider<'_>) -> bool {
    ui.label(name).on_hover_text(hint);
    let is_changed = ui.add(slider.clamping(SliderClamping::Edits)).changed();
    ui.end_row();
    is_changed
}

/// A choice with the names of the command line.
fn choice<T: ValueEnum + PartialEq + Copy>(ui: &mut Ui, name: &str, hint: &str, value: &mut T) {
    let word =
        |value: T| value.to_possible_value().map_or_else(String::new, |word| word.get_name().to_owned());
    ui.label(name).on_hover_text(hint);
    egui::ComboBox::from_id_salt(name).selected_text(word(*value)).show_ui(ui, |ui| {
        for variant in T::value_variants() {
            ui.selectable_value(value, *variant, word(*variant));
        }
    });
    ui.end_row();
}

#[cfg(test)]
mod tests {
    use super::*;
    use egui::{Context, RawInput};

    /// Settings between the steps of their sliders and beyond their ends, while the day plays.
    fn off_step_settings() -> ViewSettings {
        let sun = Some(SunPosition { azimuth_deg: -90.125, elevation_deg: 12.345_67 });
        let mut render = RenderSettings { sun, exposure_ev: 0.123_456, ..RenderSettings::default() };
        (render.post.bloom, render.post.sharpen, render.post.render_scale) = (0.812_345, 0.123_456, 0.777_77);
        (render.plants.range_m, render.plants.tree_range_m) = (1234.567, 7654.321);
        (render.plants.wind, render.plants.step_m) = (0.123_456, 1.234_567);
        (render.waves.steepness, render.waves.parallax_bias_m) = (1.234_567, -0.123_456);
        (render.pom.amplitude, render.pom.pivot, render.pom.tiling) = (1.234_567, 0.123_456, [0.777_77, 3.3]);
        let day = Day { hours: 8.765_432, plays: true };
        ViewSettings { tolerance_px: 0.0625, view_distance_m: 100, render, day }
    }

    #[test]
    fn groups_that_are_open_change_no_setting() {
        let (context, mut settings) = (Context::default(), off_step_settings());
        for _ in 0..3 {
            let output = context.run_ui(RawInput::default(), |ui| {
                image(ui, &mut settings, SunPosition::at_hour(9.0));
                post(ui, &mut settings.render.post);
                vegetation(ui, &mut settings.render.plants);
                pom(ui, &mut settings.render.pom, false);
                laboratory(ui, &mut settings.render, true);
            });
            output.drop_without_applying_deltas();
        }
        assert_eq!(settings, off_step_settings());
    }
}
