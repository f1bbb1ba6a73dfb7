//! The panel: numbers of the frame and of the session, and the two sliders that trade detail for
//! speed.

use crate::looks::{Diffuse, Looks, Shadows, Show, SunPlace, Tiling, Visibility, WaterTier};
use crate::plants::{Cull, PlantKnobs};
use crate::relief::ReliefKnobs;
use crate::relief::knobs::{Heights, LoopForm, Refine, ReliefShadow, ReliefTier, Silhouette};
use crate::render::cull::Told;
use crate::stats::FrameTimes;
use crate::voyage::Link;
use clap::ValueEnum;
use protocol::Delivery;
use std::time::Duration;

/// Frames that the times of the panel look back on.
const RECENT: usize = 240;

/// What the panel shows.
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
    pub plants: Told,
    /// Chunks drawn coarser than wanted.
    pub wanting: usize,
    /// Bytes received.
    pub bytes_received: u64,
    /// How chunks come.
    pub delivery: Delivery,
    /// Credits out.
    pub credits: u32,
    /// Resident chunks at each level.
    pub levels: [u32; 17],
    /// What to say of a scene that has no session.
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
    /// The tolerance that is drawn with, pixels.
    pub drawn_tolerance_px: f64,
    /// The GPU.
    pub adapter: &'a str,
}

/// What the panel changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knobs {
    /// Tolerated screen error, pixels.
    pub tolerance_px: f64,
    /// View distance, metres.
    pub view_distance_m: u32,
    /// Knobs of the picture.
    pub looks: Looks,
}

/// Lays the panel out.
pub fn show(ctx: &egui::Context, readings: &Readings<'_>, knobs: &mut Knobs) {
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
            // A scene without land has no levels and no chunks.
            let has_land = readings.local.is_none();
            if has_land {
                detail(ui, readings, knobs);
            }
            ui.collapsing("Picture", |ui| picture(ui, &mut knobs.looks));
            if has_land {
                ui.collapsing("Plants", |ui| plants(ui, &mut knobs.looks.plants));
            }
            ui.collapsing("Relief", |ui| relief(ui, &mut knobs.looks.relief, has_land));
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

/// How fine and how far the land is.
fn detail(ui: &mut egui::Ui, readings: &Readings<'_>, knobs: &mut Knobs) {
    ui.add(egui::Slider::new(&mut knobs.tolerance_px, 0.5..=16.0).logarithmic(true).text("tolerance, px"));
    if readings.drawn_tolerance_px > knobs.tolerance_px * 1.01 {
        ui.label(format!("chunk memory is full: drawn with {:.1} px", readings.drawn_tolerance_px));
    }
    ui.add(
        egui::Slider::new(&mut knobs.view_distance_m, 1000..=32_000)
            .logarithmic(true)
            .text("view distance, m"),
    );
}

/// The knobs of the picture: one row each, named as their options are.
fn picture(ui: &mut egui::Ui, looks: &mut Looks) {
    egui::Grid::new("picture").num_columns(2).show(ui, |ui| {
        choice::<Show>(ui, "show", &mut looks.show);
        choice::<Shadows>(ui, "shadows", &mut looks.shadows);
        choice::<Tiling>(ui, "tiling", &mut looks.tiling);
        choice::<WaterTier>(ui, "water", &mut looks.water);
        let waves = &mut looks.waves;
        ui.weak("parallax");
        ui.add(egui::Slider::new(&mut waves.parallax_factor, 0.0..=1.0));
        ui.end_row();
        ui.weak("water bias");
        ui.add(egui::Slider::new(&mut waves.parallax_bias_m, -2.0..=2.0).suffix(" m"));
        ui.end_row();
        ui.weak("steepness");
        ui.add(egui::Slider::new(&mut waves.steepness, 0.0..=4.0));
        ui.end_row();
        sun(ui, &mut looks.sun);
        choice::<Diffuse>(ui, "diffuse", &mut looks.diffuse);
        choice::<Visibility>(ui, "visibility", &mut looks.visibility);
        ui.weak("exposure");
        ui.add(egui::Slider::new(&mut looks.exposure_ev, -8.0..=8.0).suffix(" EV"));
        ui.end_row();
    });
}

/// The knobs of plants and of what hides them.
fn plants(ui: &mut egui::Ui, knobs: &mut PlantKnobs) {
    fn row(ui: &mut egui::Ui, name: &str, slider: egui::Slider<'_>) {
        ui.weak(name);
        ui.add(slider);
        ui.end_row();
    }
    egui::Grid::new("plants").num_columns(2).show(ui, |ui| {
        row(ui, "grass", egui::Slider::new(&mut knobs.density, 0..=PlantKnobs::MAX_DENSITY));
        row(ui, "range", egui::Slider::new(&mut knobs.range_m, 0.0..=1000.0).suffix(" m"));
        let thin_from = egui::Slider::new(&mut knobs.thin_from_m, 1.0..=400.0).logarithmic(true);
        row(ui, "thin from", thin_from.suffix(" m"));
        row(ui, "widest", egui::Slider::new(&mut knobs.widest, 1.0..=16.0));
        row(ui, "trees", egui::Slider::new(&mut knobs.trees, 0..=PlantKnobs::MAX_TREES));
        let farthest = 0.0..=PlantKnobs::MAX_RANGE_M;
        row(ui, "tree range", egui::Slider::new(&mut knobs.tree_range_m, farthest).suffix(" m"));
        row(ui, "wind", egui::Slider::new(&mut knobs.wind, 0.0..=1.0));
        row(ui, "lean", egui::Slider::new(&mut knobs.lean, 0.0..=1.0));
        choice::<Cull>(ui, "cull", &mut knobs.cull);
        row(ui, "stay", egui::Slider::new(&mut knobs.stay, 0..=60).suffix(" frames"));
        row(ui, "step", egui::Slider::new(&mut knobs.step_m, 0.25..=16.0).logarithmic(true).suffix(" m"));
    });
}

/// The knobs of reliefs. Moving one builds no pipeline; the first choice of cones bakes them.
fn relief(ui: &mut egui::Ui, knobs: &mut ReliefKnobs, has_land: bool) {
    fn row(ui: &mut egui::Ui, name: &str, slider: egui::Slider<'_>) {
        ui.weak(name);
        ui.add(slider);
        ui.end_row();
    }
    egui::Grid::new("relief").num_columns(2).show(ui, |ui| {
        choice::<ReliefTier>(ui, "relief", &mut knobs.tier);
        if knobs.tier == ReliefTier::Cones && has_land {
            ui.weak("");
            ui.weak("the land has no cones: drawn by pyramid");
            ui.end_row();
        }
        let steps = 1..=ReliefKnobs::MAX_STEPS;
        row(ui, "steps down", egui::Slider::new(&mut knobs.steps_min, steps.clone()).logarithmic(true));
        row(ui, "steps along", egui::Slider::new(&mut knobs.steps_max, steps).logarithmic(true));
        choice::<Refine>(ui, "refine", &mut knobs.refine);
        let rounds = 0..=ReliefKnobs::MAX_REFINEMENTS;
        row(ui, "refinements", egui::Slider::new(&mut knobs.refinements, rounds));
        choice::<LoopForm>(ui, "loop", &mut knobs.loop_form);
        choice::<Heights>(ui, "heights", &mut knobs.heights);
        choice::<ReliefShadow>(ui, "shadow", &mut knobs.shadow);
        row(ui, "pivot", egui::Slider::new(&mut knobs.pivot, 0.0..=1.0));
        row(ui, "amplitude", egui::Slider::new(&mut knobs.amplitude, 0.0..=ReliefKnobs::MAX_AMPLITUDE));
        if !has_land {
            let tiling = ReliefKnobs::MIN_TILING..=ReliefKnobs::MAX_TILING;
            let [u, v] = &mut knobs.tiling;
            row(ui, "tiling along u", egui::Slider::new(u, tiling.clone()).logarithmic(true));
            row(ui, "tiling along v", egui::Slider::new(v, tiling).logarithmic(true));
        }
        let fade = 0.0..=ReliefKnobs::MAX_FADE_PX;
        row(ui, "fade below", egui::Slider::new(&mut knobs.fade_px, fade).suffix(" px"));
        ui.weak("depth");
        ui.checkbox(&mut knobs.depth, "its own");
        ui.end_row();
        choice::<Silhouette>(ui, "silhouette", &mut knobs.silhouette);
        let horizon = &mut knobs.horizon;
        row(ui, "horizon", egui::Slider::new(&mut horizon.strength, 0.0..=4.0));
        row(ui, "height bias", egui::Slider::new(&mut horizon.height_bias, 0.0..=1.0));
        row(ui, "safe above", egui::Slider::new(&mut horizon.safe_threshold, 0.0..=0.95));
        row(ui, "falloff", egui::Slider::new(&mut horizon.falloff, 0.5..=8.0));
    });
}

/// The sun: where the scene puts it, or where two sliders do.
fn sun(ui: &mut egui::Ui, place: &mut Option<SunPlace>) {
    ui.weak("sun");
    let mut is_moved = place.is_some();
    if ui.checkbox(&mut is_moved, "moved").changed() {
        *place = is_moved.then_some(SunPlace { azimuth_deg: 120.0, elevation_deg: 30.0 });
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

/// One of several, by the words of the command line.
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
        ("chunks", format!("{} drawn, {} of {} here", readings.drawn, readings.resident, readings.capacity)),
        ("still coarse", readings.wanting.to_string()),
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

/// Plants drawn; those that found no room are told of too.
fn plants_of(told: &Told) -> String {
    let drawn = format!("{:.1} k", f64::from(told.clumps) / 1e3);
    match told.clumps_lost + told.blocks_lost {
        0 => drawn,
        _ => {
            format!("{drawn}; {} k clumps, {} blocks had no room", told.clumps_lost / 1000, told.blocks_lost)
        }
    }
}

/// One bar per level, finest on the left.
fn histogram(ui: &mut egui::Ui, levels: &[u32; 17]) {
    let highest = levels.iter().copied().max().unwrap_or(0).max(1) as f32;
    let last = levels.iter().rposition(|count| *count > 0).unwrap_or(0);
    ui.weak(format!("chunks here by level, 0 to {last}"));
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
