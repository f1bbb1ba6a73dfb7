//! A frame of the window: camera, chunks, drawing, panel.

use super::{ARRIVAL_FADE, FrameOutcome, LONG_NOTICE_DURATION, NOTICE_DURATION, WindowState};
use crate::camera::{Pose, Projection};
use crate::features::terrain_clipmap::textures::TILES_PER_FRAME;
use crate::features::terrain_shadow::pass::PER_FRAME;
use crate::features::vegetation::gpu_cull::CullStats;
use crate::features::vegetation::stats::StatsCopy;
use crate::frame::{FrameData, TRIANGLES_PER_INSTANCE};
use crate::gpu::surface::NextTexture;
use crate::gpu::{GpuError, Image, OffscreenTarget};
use crate::lod::clearance;
use crate::native::app::capture;
use crate::native::app::panel::{self, Readings, Request};
use crate::native::app::view_settings::ViewSettings;
use crate::native::background::Background;
use crate::native::png_file;
use crate::settings::SunPosition;
use crate::stream::streamer::Link;
use crate::view::ViewParams;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Chunks inserted per frame: about 2 ms of uploads, so that bursts do not drop frames.
const ARRIVALS_PER_FRAME: usize = 48;

/// Pause while a window cannot be drawn into.
const HIDDEN_PAUSE: Duration = Duration::from_millis(50);

/// Frames between two copies of the culling counts. At low frame rates fewer: a copy at least every
/// so often.
const CULL_STATS_INTERVAL: usize = 60;
const CULL_STATS_AGE: Duration = Duration::from_secs(2);

/// Longest camera step; a longer one would jump. Above 4 frames a second the camera moves as fast
/// as the panel says.
const LONGEST_STEP: Duration = Duration::from_millis(250);

/// Shown over the first frames.
const FIRST_HINT: &str = "drag to look, W A S D to fly, 1 to 8 for places, H for all keys";

impl WindowState {
    /// Draws a frame on the present device.
    pub(super) fn draw_frame(&mut self) -> anyhow::Result<FrameOutcome> {
        self.gpu.check()?;
        let (texture, view) = match self.surface.next(&self.gpu) {
            NextTexture::Ready(texture, view) => (texture, view),
            NextTexture::Skip => {
                self.last_frame_at = Instant::now();
                self.no_frame_before = self.last_frame_at + HIDDEN_PAUSE;
                return Ok(FrameOutcome::Continue);
            }
            NextTexture::Lost => {
                let surface = self.gpu.instance.create_surface(Arc::clone(&self.window))?;
                let size = self.window.inner_size();
                self.surface.replace(&self.gpu, surface, (size.width, size.height))?;
                return Ok(FrameOutcome::Continue);
            }
        };
        let step = self.step();
        self.visit(step);
        let ViewSettings { day, render, .. } = &mut self.settings;
        self.clock.step(step, day, &mut render.sun);
        let (width, height) = self.surface.size();
        self.renderer.resize((width, height));
        self.renderer.advance(step);
        let view_params = ViewParams {
            pose: self.controls.pose(),
            projection: Projection { fov_deg: self.args.fov, width, height },
            view_distance_m: self.settings.view_distance_m,
            tolerance_px: self.settings.tolerance_px,
            time_s: self.clock.time_s(),
            settings: self.settings.render,
        };
        let (gpu, renderer) = (&self.gpu, &mut self.renderer);
        let selection =
            self.streamer.update(&view_params, self.program_started.elapsed(), ARRIVALS_PER_FRAME, |chunk| {
                renderer.upload(gpu, chunk);
            });
        self.follow_world()?;
        let (gpu, renderer) = (&self.gpu, &mut self.renderer);
        let pose = clearance::raised(view_params.pose, self.streamer.cache(), &selection.drawn);
        let view_params = ViewParams { pose, ..view_params };
        self.last_view = Some(view_params);
        let frame = view_params.frame(self.args.scene, self.streamer.cache(), &selection);
        (self.chunks_drawn, self.instances) = (frame.chunks, frame.instances.len());
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        renderer.fill_clipmap(gpu, &frame, TILES_PER_FRAME);
        renderer.trace_shadows(gpu, &frame, PER_FRAME, &mut encoder);
        renderer.draw(gpu, &frame, &mut encoder, &view);
        let now = Instant::now();
        // Also without the panel: nothing more will come.
        if let Link::GivenUp(cause) = self.streamer.link() {
            self.notices.show(cause, now, NOTICE_DURATION);
        }
        let has_notices = self.notices.shown(now).next().is_some();
        self.has_overlay = self.show_panel || self.show_keys;
        // Also for events alone: they would wait until there is something to show.
        if self.has_overlay || has_notices || self.overlay.has_events() {
            let readings = Readings {
                times: &self.times,
                drawn: self.chunks_drawn,
                resident: self.streamer.cache().len(),
                capacity: self.slots,
                triangles: self.instances as u64 * TRIANGLES_PER_INSTANCE,
                plants: self.cull_stats,
                missing: selection.missing,
                traffic: self.streamer.stream().traffic(),
                missed: self.streamer.missed(),
                last_miss: self.streamer.last_miss(),
                delivery: self.streamer.stream().delivery(),
                levels: self.streamer.cache().level_histogram(),
                local: self.args.scene.panel_legend(),
                link: self.streamer.link(),
                refusal: self.streamer.refusal(),
                now: self.program_started.elapsed(),
                camera: view_params.pose.to_string(),
                speed_m: self.controls.speed_m(),
                orbiting: self.controls.is_orbiting(),
                drawn_tolerance_px: self.streamer.tolerance_px(&view_params),
                adapter: &self.adapter,
                notice: self.driver_notice.as_deref(),
                scene_sun: SunPosition::of(self.args.scene.light().sun),
                is_under_water: frame.uniforms.eye_height_m <= 0.0,
            };
            let (settings, notices) = (&mut self.settings, &self.notices);
            let (show_panel, show_keys) = (self.show_panel, self.show_keys);
            let mut request = Request::default();
            let painted = self.overlay.run(&self.window, (width, height), |ctx| {
                if show_panel {
                    // egui may lay out a frame twice.
                    let new = panel::show(ctx, &readings, settings);
                    request =
                        Request { place: request.place.or(new.place), resets: request.resets || new.resets };
                }
                if show_keys {
                    panel::show_keys(ctx);
                }
                panel::show_notices(ctx, notices.shown(now));
            });
            self.overlay.paint(gpu, painted, &mut encoder, &view);
            self.wanted = request.place.or(self.wanted);
            if request.resets {
                (self.settings, self.view_distance_before_place_m) =
                    (self.initial_settings, self.initial_view_distance_before_place_m);
            }
        }
        let copy = self.copy_cull_stats(now, frame.plants.is_some(), &mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
        self.follow_cull_stats(copy);
        self.window.pre_present_notify();
        self.gpu.queue.present(texture);
        if self.frames > 0 {
            self.times.push(step);
        }
        self.frames += 1;
        self.rebuilds.frame_drawn();
        if self.first_picture.is_none() {
            self.first_picture = Some(self.program_started.elapsed());
            self.notices.show(FIRST_HINT, Instant::now(), LONG_NOTICE_DURATION);
        }
        if std::mem::take(&mut self.takes_screenshot) {
            self.save_screenshot(&frame)?;
        }
        let is_last = self.args.frames.is_some_and(|frames| self.frames >= frames as usize) && self.may_end();
        let vegetation = self.renderer.vegetation().filter(|_| frame.plants.is_some());
        if let Some(vegetation) = vegetation.filter(|_| is_last) {
            self.cull_stats = vegetation.read_stats(&self.gpu).unwrap_or_default();
        }
        if is_last && let Some(path) = self.args.window_test.last_frame.clone() {
            self.renderer.finish_shading(&self.gpu, &frame)?;
            png_file::write(&path, &self.picture(&frame)?)?;
        }
        if self.args.window_test.lose_gpu_at.contains(&(self.frames as u32)) {
            self.gpu.device.destroy();
        }
        Ok(if is_last { FrameOutcome::Quit } else { FrameOutcome::Continue })
    }

    /// Whether the last frame may be drawn: a test compares pictures of a complete view.
    fn may_end(&self) -> bool {
        let complete = self.streamer.milestones().complete_view;
        self.args.window_test.last_frame.is_none()
            || complete.is_some_and(|at| self.program_started.elapsed() > at + 2 * ARRIVAL_FADE)
    }

    /// Searches the start of a world that a server announces, for the first time or in place of
    /// another, and goes there unless the user has moved.
    fn follow_world(&mut self) -> anyhow::Result<()> {
        let world = self.streamer.world();
        if world.is_some() && world != self.world {
            (self.world, self.places, self.search) = (world, None, None);
            if let Some(land) = self.streamer.cache().land().filter(|_| self.args.follows_world()) {
                let (land, args) = (*land, self.args.clone());
                self.search = Some(Background::start("tombolo-start", move || args.start_in(&land))?);
            }
        }
        if let Some(search) = &mut self.search
            && let Some(start) = search.poll()?
        {
            self.search = None;
            if !self.controls.has_moved() {
                self.controls.start_at(start);
            }
            self.start_pose = start;
        }
        Ok(())
    }

    /// Moves the camera by the time since the last frame, which it returns. Zero before the first
    /// frame: starting takes seconds.
    fn step(&mut self) -> Duration {
        let now = Instant::now();
        let step = if self.frames == 0 { Duration::ZERO } else { now - self.last_frame_at };
        self.last_frame_at = now;
        let cache = self.streamer.cache();
        let ground = |pose: &Pose| {
            let eye = pose.eye();
            cache.ground(eye.units[0], eye.units[2])
        };
        let is_settled = self.streamer.is_settled() && self.streamer.missed() == 0;
        self.controls.step(step.min(LONGEST_STEP).as_secs_f64(), is_settled, ground);
        step
    }

    /// Records a copy of the culling counts, if it is time for one and none is on its way.
    fn copy_cull_stats(
        &mut self,
        now: Instant,
        has_plants: bool,
        encoder: &mut wgpu::CommandEncoder,
    ) -> Option<StatsCopy> {
        let is_due = self.frames.is_multiple_of(CULL_STATS_INTERVAL)
            || now - self.cull_stats_copied_at > CULL_STATS_AGE;
        if !is_due || self.cull_stats_pending.is_some() {
            return None;
        }
        self.cull_stats_copied_at = now;
        let vegetation = self.renderer.vegetation().filter(|_| has_plants);
        if vegetation.is_none() {
            self.cull_stats = CullStats::default();
        }
        vegetation.map(|vegetation| vegetation.copy_stats(&self.gpu.device, encoder))
    }

    /// Takes the counts when they have come; never waits. A failed GPU is reported by the next
    /// frame.
    fn follow_cull_stats(&mut self, copy: Option<StatsCopy>) {
        self.cull_stats_pending = self.cull_stats_pending.take().or_else(|| copy.map(StatsCopy::start));
        let has_come = self.cull_stats_pending.as_mut().map(|read| read.poll(&self.gpu.device));
        if !matches!(has_come, None | Some(Ok(false))) {
            let read = self.cull_stats_pending.take();
            self.cull_stats = read.and_then(|read| read.result().ok()).unwrap_or_default();
        }
    }

    /// Draws a frame without the panel.
    fn picture(&mut self, frame: &FrameData) -> Result<Image, GpuError> {
        let (width, height) = self.surface.size();
        let target = OffscreenTarget::with_format(&self.gpu.device, width, height, self.surface.format);
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.renderer.draw(&self.gpu, frame, &mut encoder, &target.view);
        self.gpu.queue.submit([encoder.finish()]);
        target.read(&self.gpu)
    }

    /// Draws a frame without the panel into a new file.
    fn save_screenshot(&mut self, frame: &FrameData) -> anyhow::Result<()> {
        // No time passes: the exposure stays as it is.
        self.renderer.advance(Duration::ZERO);
        let image = self.picture(frame)?;
        let line = match capture::save(Path::new("."), &image) {
            Ok(path) => match std::path::absolute(&path) {
                Ok(path) => format!("wrote {}", path.display()),
                Err(_) => format!("wrote {}", path.display()),
            },
            Err(error) => format!("{error:#}"),
        };
        self.notices.show(&line, Instant::now(), 2 * NOTICE_DURATION);
        Ok(())
    }
}
