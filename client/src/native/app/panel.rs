//! The panel: numbers of frame and session, places, and most settings.

use super::keys;
use super::panel_settings::{image, laboratory, pom, post, vegetation};
use super::view_settings::ViewSettings;
use crate::features::vegetation::gpu_cull::CullStats;
use crate::scene::places::Place;
use crate::settings::SunPosition;
use crate::stats::FrameTimes;
use crate::stream::Traffic;
use crate::stream::streamer::Link;
use protocol::Delivery;
use std::time::Duration;
use terrain::lod::MAX_VIEW_DISTANCE_M;

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
    /// Delivery mode.
    pub delivery: Delivery,
    /// Counters of the stream.
    pub traffic: Traffic,
    /// Chunks that were bad or refused and are drawn coarser.
    pub missed: usize,
    /// Error of the last of them.
    pub last_miss: Option<&'a str>,
    /// Resident chunks at each level.
    pub levels: [u32; 17],
    /// Legend of a local scene.
    pub local: Option<&'static str>,
    /// The session.
    pub link: &'a Link,
    /// Why the server refused the view, if it did.
    pub refusal: Option<&'a str>,
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
    /// Settings that the driver changed at the start.
    pub notice: Option<&'a str>,
    /// The sun of the scene.
    pub scene_sun: SunPosition,
    /// Whether the eye is under water, where no plants are drawn.
    pub is_under_water: bool,
}

/// Action that the user requested by a button.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Request {
    /// A place to go to.
    pub place: Option<Place>,
    /// All settings as they were at the start.
    pub resets: bool,
}

/// Lays the panel out.
pub fn show(ctx: &egui::Context, readings: &Readings<'_>, settings: &mut ViewSettings) -> Request {
    let mut request = Request::default();
    egui::Window::new("Tombolo")
        .default_pos([12.0, 12.0])
        .default_size([300.0, 560.0])
        .resizable(true)
        .vscroll(true)
        .constrain(true)
        .frame(egui::Frame::window(&ctx.style_of(egui::Theme::Dark)).multiply_with_opacity(0.82))
        .show(ctx, |ui| {
            ui.label(connection(readings));
            if let Some(notice) = readings.notice {
                ui.label(notice);
            }
            ui.separator();
            numbers(ui, readings, settings);
            ui.separator();
            // Scenes without land have no levels, no chunks and no places.
            let has_land = readings.local.is_none();
            if has_land {
                detail(ui, readings, settings);
                request.place = places(ui);
            }
            ui.collapsing("Picture", |ui| image(ui, settings, readings.scene_sun));
            ui.collapsing("Tone", |ui| post(ui, &mut settings.render.post));
            if has_land {
                ui.collapsing("Vegetation", |ui| vegetation(ui, &mut settings.render.plants));
            }
            ui.collapsing("Relief", |ui| pom(ui, &mut settings.render.pom, has_land));
            ui.collapsing("Laboratory", |ui| laboratory(ui, &mut settings.render, has_land));
            let reset = ui.button("Reset all settings");
            request.resets = reset.on_hover_text("Every setting as it was at the start").clicked();
            ui.separator();
            if has_land {
                histogram(ui, &readings.levels);
            }
            ui.collapsing("Keys", key_lines);
        });
    request
}

/// Buttons of the places.
fn places(ui: &mut egui::Ui) -> Option<Place> {
    let mut chosen = None;
    ui.horizontal_wrapped(|ui| {
        for (index, place) in Place::ALL.into_iter().enumerate() {
            let button = ui.small_button(place.label());
            if button.on_hover_text(format!("Go there (key {})", index + 1)).clicked() {
                chosen = Some(place);
            }
        }
    });
    chosen
}

/// The keys and what they do.
pub fn key_lines(ui: &mut egui::Ui) {
    egui::Grid::new("keys").num_columns(2).show(ui, |ui| {
        for (key, does) in keys::LINES {
            ui.strong(key);
            ui.label(does);
            ui.end_row();
        }
    });
}

/// A window with the keys alone.
pub fn show_keys(ctx: &egui::Context) {
    egui::Window::new("Keys")
        .anchor(egui::Align2::CENTER_CENTER, [0.0, 0.0])
        .resizable(false)
        .collapsible(false)
        .show(ctx, key_lines);
}

/// Lines over the picture, with their opacity.
pub fn show_notices<'a>(ctx: &egui::Context, lines: impl Iterator<Item = (&'a str, f32)>) {
    egui::Area::new(egui::Id::unique("notices"))
        .anchor(egui::Align2::CENTER_BOTTOM, [0.0, -24.0])
        .interactable(false)
        .show(ctx, |ui| {
            for (line, opacity) in lines {
                let alpha = |of: u8| (f32::from(of) * opacity) as u8;
                let text = egui::RichText::new(line).size(16.0);
                let text = text.color(egui::Color32::from_white_alpha(alpha(255)));
                let text = text.background_color(egui::Color32::from_black_alpha(alpha(150)));
                ui.vertical_centered(|ui| ui.label(text));
            }
        });
}

/// Tolerance and view distance.
fn detail(ui: &mut egui::Ui, readings: &Readings<'_>, settings: &mut ViewSettings) {
    let tolerance = egui::Slider::new(&mut settings.tolerance_px, 0.5..=16.0).logarithmic(true);
    ui.add(tolerance.clamping(egui::SliderClamping::Edits).text("tolerance, px"))
        .on_hover_text("Vertical error of the drawn land on screen; less is finer and slower");
    if readings.drawn_tolerance_px > settings.tolerance_px * 1.01 {
        ui.label(format!("chunk memory is full: drawn with {:.1} px", readings.drawn_tolerance_px));
    }
    let distance = egui::Slider::new(&mut settings.view_distance_m, 1000..=MAX_VIEW_DISTANCE_M);
    ui.add(distance.logarithmic(true).clamping(egui::SliderClamping::Edits).text("view, m"))
        .on_hover_text("Distance up to which land is drawn; the next islands are 5 to 9 km away");
}

fn connection(readings: &Readings<'_>) -> String {
    if let Some(line) = readings.local {
        return line.to_owned();
    }
    match readings.link {
        Link::Connecting => "connecting".to_owned(),
        Link::Connected(server) => match readings.refusal {
            None => format!("connected to {server}"),
            Some(cause) => format!("connected to {server}, which refused the view: {cause}"),
        },
        Link::Waiting { cause, retry_at } => match retry_at.saturating_sub(readings.now) {
            Duration::ZERO => format!("{cause}; connecting again"),
            left => format!("{cause}; next attempt in {:.1} s", left.as_secs_f64()),
        },
        Link::GivenUp(cause) => cause.clone(),
    }
}

fn numbers(ui: &mut egui::Ui, readings: &Readings<'_>, settings: &ViewSettings) {
    let frame = format!(
        "{:.1} ms p50, {:.1} ms p99",
        readings.times.quantile_ms(0.5, RECENT),
        readings.times.quantile_ms(0.99, RECENT)
    );
    let plants = &settings.render.plants;
    let plants = match (plants.any(), readings.is_under_water) {
        (false, _) => "off: raise grass or trees under Vegetation".to_owned(),
        (true, true) => "none under water".to_owned(),
        (true, false) => plants_of(&readings.plants),
    };
    let session = [
        (
            "chunks",
            format!("{} drawn, {} of {} resident", readings.drawn, readings.resident, readings.capacity),
            "Squares of land: drawn now, and held in memory",
        ),
        ("still coarse", readings.missing.to_string(), "Chunks whose finer ones have not arrived"),
        ("triangles", format!("{:.2} M", readings.triangles as f64 / 1e6), "Of the land, in this frame"),
        ("plants", plants, "Clumps of grass and trees drawn"),
        (
            "received",
            format!(
                "{:.2} MiB, {} delivery",
                readings.traffic.bytes_received as f64 / f64::from(1 << 20),
                readings.delivery
            ),
            "From the server since the start",
        ),
        ("credits", readings.traffic.credits.to_string(), "Chunks that the server may still send"),
        (
            "bad chunks",
            rejects(readings),
            "Wrong, not asked for, or refused; drawn coarser and requested again",
        ),
    ];
    let session = session.into_iter().filter(|_| readings.local.is_none());
    ui.label(readings.adapter);
    egui::Grid::new("numbers").num_columns(2).show(ui, |ui| {
        let first = ("frame", frame, "Time from frame to frame: median, and 99 of 100 are shorter");
        for (name, value, hint) in std::iter::once(first).chain(session) {
            ui.label(name).on_hover_text(hint);
            ui.label(value);
            ui.end_row();
        }
        ui.label("speed").on_hover_text("Wheel and Shift change it; slower below 4 frames a second");
        let speed = format!("{:.0} m/s", readings.speed_m);
        ui.label(if readings.orbiting { "orbit".to_owned() } else { speed });
        ui.end_row();
    });
    camera(ui, &readings.camera);
}

/// Bad and refused chunks, and what was wrong with the last.
fn rejects(readings: &Readings<'_>) -> String {
    let Traffic { bad_chunks, refused_chunks, .. } = readings.traffic;
    match readings.last_miss {
        None => "none".to_owned(),
        Some(detail) => {
            format!("{bad_chunks} bad, {refused_chunks} refused, {} missing; last: {detail}", readings.missed)
        }
    }
}

/// The pose as `--camera` takes it, to select or copy.
fn camera(ui: &mut egui::Ui, camera: &str) {
    ui.horizontal_wrapped(|ui| {
        ui.label("camera").on_hover_text("East, up, south in metres; heading and pitch in degrees");
        ui.add(egui::Label::new(egui::RichText::new(camera).monospace()).selectable(true));
        if ui.small_button("copy").on_hover_text("Copies the option --camera for this view").clicked() {
            // With `=`, because a number may begin with a minus.
            ui.ctx().copy_text(format!("--camera={camera}"));
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
    ui.label(format!("resident chunks by level, 0 to {last}"));
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
