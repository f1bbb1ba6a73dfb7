//! The panel: numbers of frame and session, and all settings.

use crate::features::pom::PomSettings;
use crate::features::pom::settings::{Heights, LoopForm, PomMethod, PomShadow, Refine, Silhouette};
use crate::features::vegetation::gpu_cull::CullStats;
use crate::features::vegetation::{Cull, VegetationSettings};
use crate::features::water::WaterTier;
use crate::settings::{Diffuse, RenderSettings, Shadows, Show, SunPosition, Tiling, Visibility};
use crate::stats::FrameTimes;
use crate::stream::streamer::Link;
use clap::ValueEnum;
use protocol::Delivery;
use std::time::Duration;

/// Window of the displayed frame times.
const RECENT: usize = 240;

/// Displayed values.
#[derive(Debug)]
pub struct Readings<'a> {
    /// Times of the latest frames.
    pub times: &'a FrameTimes,
    /// Chunks drawn.
    pub drawn: usize,
    /// Chunks in memory.
    pub resident: usize,
    /// Slots.
    pub capacity: u32,
    /// Triangles of the frame.
    pub triangles: u64,
    /// Clumps of grass and trees.
    pub plants: CullStats,
    /// Chunks drawn coarser than wanted.
    pub missing: usize,
    /// Bytes received.
    pub bytes_received: u64,
    /// Delivery mode.
    pub delivery: Delivery,
    /// Granted credits.
    pub credits: u32,
    /// Resident chunks at each level.
    pub levels: [u32; 17],
    /// Legend of a local scene.
    pub local: Option<&'static str>,
    /// The session.
    pub link: &'a Link,
    /// Time since the start.
    pub now: Duration,
    /// Camera as `--camera` takes it.
    pub camera: String,
    /// Flying speed, metres a second.
    pub speed_m: f64,
    /// Whether the camera circles.
    pub orbiting: bool,
    /// The tolerance in use, pixels.
    pub drawn_tolerance_px: f64,
    /// The GPU.
    pub adapter: &'a str,
}

/// Settings that the panel edits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewSettings {
    /// Tolerated screen error, pixels.
    pub tolerance_px: f64,
    /// View distance, metres.
    pub view_distance_m: u32,
    /// Render settings.
    pub render: RenderSettings,
}

/// Lays the panel out.
pub fn show(ctx: &egui::Context, readings: &Readings<'_>, settings: &mut ViewSettings) {
    egui::Window::new("Tombolo")
        .anchor(egui::Align2::LEFT_TOP, [12.0, 12.0])
        .resizable(false)
        .default_width(250.0)
        .frame(egui::Frame::window(&ctx.style_of(egui::Theme::Dark)).multiply_with_opacity(0.82))
        .show(ctx, |ui| {
            ui.label(connection(readings));
            ui.separator();
            numbers(ui, readings);
            ui.separator();
            // Scenes without land have no levels and no chunks.
            let has_land = readings.local.is_none();
            if has_land {
                detail(ui, readings, settings);
            }
            ui.collapsing("Image", |ui| image(ui, &mut settings.render));
            if has_land {
                ui.collapsing("Vegetation", |ui| plants(ui, &mut settings.render.plants));
            }
            ui.collapsing("Parallax", |ui| pom(ui, &mut settings.render.pom, has_land));
            ui.separator();
            if has_land {
                histogram(ui, &readings.levels);
            }
            ui.collapsing("Keys", |ui| {
                for line in [
                    "W A S D  fly      Q E  down, up",
                    "Shift  faster     wheel  speed",
                    "drag  look        O  orbit",
                    "F1  panel         Esc  quit",
                ] {
                    ui.monospace(line);
                }
            });
        });
}

/// Tolerance and view distance.
fn detail(ui: &mut egui::Ui, readings: &Readings<'_>, settings: &mut ViewSettings) {
    ui.add(egui::Slider::new(&mut settings.tolerance_px, 0.5..=16.0).logarithmic(true).text("tolerance, px"));
    if readings.drawn_tolerance_px > settings.tolerance_px * 1.01 {
        ui.label(format!("chunk memory is full: drawn with {:.1} px", readings.drawn_tolerance_px));
    }
    ui.add(
        egui::Slider::new(&mut settings.view_distance_m, 1000..=32_000)
            .logarithmic(true)
            .text("view distance, m"),
    );
}

/// Render settings, one row each, with the names of the options.
fn image(ui: &mut egui::Ui, settings: &mut RenderSettings) {
    egui::Grid::new("image").num_columns(2).show(ui, |ui| {
        choice::<Show>(ui, "show", &mut settings.show);
        choice::<Shadows>(ui, "shadows", &mut settings.shadows);
        choice::<Tiling>(ui, "tiling", &mut settings.tiling);
        choice::<WaterTier>(ui, "water", &mut settings.water);
        let waves = &mut settings.waves;
        ui.weak("parallax");
        ui.add(egui::Slider::new(&mut waves.parallax_factor, 0.0..=1.0));
        ui.end_row();
        ui.weak("water bias");
        ui.add(egui::Slider::new(&mut waves.parallax_bias_m, -2.0..=2.0).suffix(" m"));
        ui.end_row();
        ui.weak("steepness");
        ui.add(egui::Slider::new(&mut waves.steepness, 0.0..=4.0));
        ui.end_row();
        sun(ui, &mut settings.sun);
        choice::<Diffuse>(ui, "diffuse", &mut settings.diffuse);
        choice::<Visibility>(ui, "visibility", &mut settings.visibility);
        ui.weak("exposure");
        ui.add(egui::Slider::new(&mut settings.exposure_ev, -8.0..=8.0).suffix(" EV"));
        ui.end_row();
    });
}

/// Vegetation and culling settings.
fn plants(ui: &mut egui::Ui, settings: &mut VegetationSettings) {
    fn row(ui: &mut egui::Ui, name: &str, slider: egui::Slider<'_>) {
        ui.weak(name);
        ui.add(slider);
        ui.end_row();
    }
    egui::Grid::new("plants").num_columns(2).show(ui, |ui| {
        row(ui, "grass", egui::Slider::new(&mut settings.density, 0..=VegetationSettings::MAX_DENSITY));
        row(ui, "range", egui::Slider::new(&mut settings.range_m, 0.0..=1000.0).suffix(" m"));
        let thin_from = egui::Slider::new(&mut settings.thin_from_m, 1.0..=400.0).logarithmic(true);
        row(ui, "thin from", thin_from.suffix(" m"));
        row(ui, "widest", egui::Slider::new(&mut settings.widest, 1.0..=16.0));
        row(ui, "trees", egui::Slider::new(&mut settings.trees, 0..=VegetationSettings::MAX_TREES));
        let farthest = 0.0..=VegetationSettings::MAX_RANGE_M;
        row(ui, "tree range", egui::Slider::new(&mut settings.tree_range_m, farthest).suffix(" m"));
        row(ui, "wind", egui::Slider::new(&mut settings.wind, 0.0..=1.0));
        row(ui, "lean", egui::Slider::new(&mut settings.lean, 0.0..=1.0));
        choice::<Cull>(ui, "cull", &mut settings.cull);
        row(ui, "stay", egui::Slider::new(&mut settings.stay, 0..=60).suffix(" frames"));
        row(ui, "step", egui::Slider::new(&mut settings.step_m, 0.25..=16.0).logarithmic(true).suffix(" m"));
    });
}

/// Parallax settings. None builds a pipeline; the first selection of cones bakes them.
fn pom(ui: &mut egui::Ui, settings: &mut PomSettings, has_land: bool) {
    fn row(ui: &mut egui::Ui, name: &str, slider: egui::Slider<'_>) {
        ui.weak(name);
        ui.add(slider);
        ui.end_row();
    }
    egui::Grid::new("parallax").num_columns(2).show(ui, |ui| {
        choice::<PomMethod>(ui, "relief", &mut settings.method);
        if settings.method == PomMethod::Cones && has_land {
            ui.weak("");
            ui.weak("the land has no cones: using max mips");
            ui.end_row();
        }
        let steps = 1..=PomSettings::MAX_STEPS;
        row(ui, "steps down", egui::Slider::new(&mut settings.steps_min, steps.clone()).logarithmic(true));
        row(ui, "steps along", egui::Slider::new(&mut settings.steps_max, steps).logarithmic(true));
        choice::<Refine>(ui, "refine", &mut settings.refine);
        let rounds = 0..=PomSettings::MAX_REFINEMENTS;
        row(ui, "refinements", egui::Slider::new(&mut settings.refinements, rounds));
        choice::<LoopForm>(ui, "loop", &mut settings.loop_form);
        choice::<Heights>(ui, "heights", &mut settings.heights);
        choice::<PomShadow>(ui, "shadow", &mut settings.shadow);
        row(ui, "pivot", egui::Slider::new(&mut settings.pivot, 0.0..=1.0));
        row(ui, "amplitude", egui::Slider::new(&mut settings.amplitude, 0.0..=PomSettings::MAX_AMPLITUDE));
        if !has_land {
            let tiling = PomSettings::MIN_TILING..=PomSettings::MAX_TILING;
            let [u, v] = &mut settings.tiling;
            row(ui, "tiling along u", egui::Slider::new(u, tiling.clone()).logarithmic(true));
            row(ui, "tiling along v", egui::Slider::new(v, tiling).logarithmic(true));
        }
        let fade = 0.0..=PomSettings::MAX_FADE_PX;
        row(ui, "fade below", egui::Slider::new(&mut settings.fade_px, fade).suffix(" px"));
        ui.weak("depth");
        ui.checkbox(&mut settings.depth, "displaced");
        ui.end_row();
        choice::<Silhouette>(ui, "silhouette", &mut settings.silhouette);
        let horizon = &mut settings.horizon;
        row(ui, "horizon", egui::Slider::new(&mut horizon.strength, 0.0..=4.0));
        row(ui, "height bias", egui::Slider::new(&mut horizon.height_bias, 0.0..=1.0));
        row(ui, "safe above", egui::Slider::new(&mut horizon.safe_threshold, 0.0..=0.95));
        row(ui, "falloff", egui::Slider::new(&mut horizon.falloff, 0.5..=8.0));
    });
}

/// Sun position: that of the scene, or by two sliders.
fn sun(ui: &mut egui::Ui, place: &mut Option<SunPosition>) {
    ui.weak("sun");
    let mut is_moved = place.is_some();
    if ui.checkbox(&mut is_moved, "moved").changed() {
        *place = is_moved.then_some(SunPosition { azimuth_deg: 120.0, elevation_deg: 30.0 });
    }
    ui.end_row();
    if let Some(place) = place {
        ui.weak("azimuth");
        ui.add(egui::Slider::new(&mut place.azimuth_deg, -180.0..=360.0).suffix("°"));
        ui.end_row();
        ui.weak("elevation");
        ui.add(egui::Slider::new(&mut place.elevation_deg, -90.0..=90.0).suffix("°"));
        ui.end_row();
    }
}

/// A choice with the names of the command line.
fn choice<T: ValueEnum + PartialEq + Copy>(ui: &mut egui::Ui, name: &str, value: &mut T) {
    let word =
        |value: T| value.to_possible_value().map_or_else(String::new, |word| word.get_name().to_owned());
    ui.weak(name);
    egui::ComboBox::from_id_salt(name).selected_text(word(*value)).show_ui(ui, |ui| {
        for variant in T::value_variants() {
            ui.selectable_value(value, *variant, word(*variant));
        }
    });
    ui.end_row();
}

fn connection(readings: &Readings<'_>) -> String {
    if let Some(line) = readings.local {
        return line.to_owned();
    }
    match readings.link {
        Link::Connecting => "connecting".to_owned(),
        Link::Connected(server) => format!("connected to {server}"),
        Link::Waiting { cause, retry_at } => {
            let seconds = retry_at.saturating_sub(readings.now).as_secs_f64();
            format!("{cause}; next attempt in {seconds:.1} s")
        }
        Link::Refused(cause) => cause.clone(),
    }
}

fn numbers(ui: &mut egui::Ui, readings: &Readings<'_>) {
    let mode = if readings.orbiting { "orbit".to_owned() } else { format!("{:.0} m/s", readings.speed_m) };
    let frame = format!(
        "{:.1} ms p50, {:.1} ms p99",
        readings.times.quantile_ms(0.5, RECENT),
        readings.times.quantile_ms(0.99, RECENT)
    );
    let session = [
        (
            "chunks",
            format!("{} drawn, {} of {} resident", readings.drawn, readings.resident, readings.capacity),
        ),
        ("still coarse", readings.missing.to_string()),
        ("triangles", format!("{:.2} M", readings.triangles as f64 / 1e6)),
        ("plants", plants_of(&readings.plants)),
        (
            "received",
            format!(
                "{:.2} MiB, {} delivery",
                readings.bytes_received as f64 / f64::from(1 << 20),
                readings.delivery
            ),
        ),
        ("credits", readings.credits.to_string()),
    ];
    let session = session.into_iter().filter(|_| readings.local.is_none());
    let camera = [("camera", readings.camera.clone()), ("speed", mode)];
    let rows = std::iter::once(("frame", frame)).chain(session).chain(camera);
    ui.weak(readings.adapter);
    egui::Grid::new("numbers").num_columns(2).show(ui, |ui| {
        for (name, value) in rows {
            ui.weak(name);
            ui.label(value);
            ui.end_row();
        }
    });
}

/// Drawn plants, and those dropped for lack of capacity.
fn plants_of(stats: &CullStats) -> String {
    let drawn = format!("{:.1} k", f64::from(stats.clumps) / 1e3);
    match stats.clumps_lost + stats.blocks_lost {
        0 => drawn,
        _ => {
            format!(
                "{drawn}; {} k clumps, {} blocks dropped: buffers full",
                stats.clumps_lost / 1000,
                stats.blocks_lost
            )
        }
    }
}

/// One bar per level, finest on the left.
fn histogram(ui: &mut egui::Ui, levels: &[u32; 17]) {
    let highest = levels.iter().copied().max().unwrap_or(0).max(1) as f32;
    let last = levels.iter().rposition(|count| *count > 0).unwrap_or(0);
    ui.weak(format!("resident chunks by level, 0 to {last}"));
    let (area, _) = ui.allocate_exact_size(egui::vec2(ui.available_width(), 36.0), egui::Sense::hover());
    let width = area.width() / (last + 1) as f32;
    for (level, count) in levels.iter().enumerate().take(last + 1) {
        let left = area.left() + width * level as f32;
        let top = area.bottom() - area.height() * *count as f32 / highest;
        let bar = egui::Rect::from_min_max(
            egui::pos2(left + 1.0, top),
            egui::pos2(left + width - 1.0, area.bottom()),
        );
        ui.painter().rect_filled(bar, 2.0, egui::Color32::from_rgb(110, 170, 200));
    }
}
