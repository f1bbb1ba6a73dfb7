//! The window: winit's event loop with a streamer, a renderer and a panel.

pub mod capture;
pub mod clock;
pub mod controls;
pub mod keys;
pub mod notices;
pub mod overlay;
pub mod panel;
pub mod panel_settings;
pub mod view_settings;

use crate::cache::ChunkCache;
use crate::cache::SLOT_BYTES;
use crate::camera::{Pose, Projection};
use crate::features::materials::CustomMaterials;
use crate::features::terrain::pool::ChunkPool;
use crate::features::terrain_clipmap::textures::TILES_PER_FRAME;
use crate::features::terrain_shadow::pass::PER_FRAME;
use crate::features::vegetation::gpu_cull::CullStats;
use crate::frame::FrameData;
use crate::frame::TRIANGLES_PER_INSTANCE;
use crate::gpu;
use crate::gpu::rebuild::{MOST_REBUILDS, Rebuilds};
use crate::gpu::surface::{NextTexture, WindowSurface};
use crate::gpu::{Gpu, GpuError, OffscreenTarget};
use crate::lod::clearance;
use crate::native::args::Args;
use crate::native::background::Background;
use crate::native::profile::Profile;
use crate::native::screenshot::{open_stream, write_stats};
use crate::native::textures;
use crate::renderer::{RenderOptions, Renderer};
use crate::scene::places::{Place, PlaceFinder};
use crate::settings::SunPosition;
use crate::stats::{FrameTimes, Stats};
use crate::stream::ChunkStream;
use crate::stream::streamer::{Link, WorldStreamer};
use crate::view::ViewParams;
use anyhow::{Context as _, anyhow};
use clock::{Clock, Day};
use controls::Controls;
use keys::Action;
use notices::Notices;
use overlay::Overlay;
use panel::{Readings, Request};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use view_settings::ViewSettings;
use winit::application::ApplicationHandler;
use winit::event::{ElementState, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, OwnedDisplayHandle};
use winit::keyboard::{ModifiersState, PhysicalKey};
use winit::window::{Fullscreen, Window, WindowId};

/// Chunks inserted per frame: about 2 ms of uploads, so that bursts do not drop frames.
const ARRIVALS_PER_FRAME: usize = 48;

/// Fade-in time of finer chunks: long enough to hide popping, short enough not to be noticed.
const ARRIVAL_FADE: Duration = Duration::from_millis(250);

/// Pause while a window cannot be drawn into.
const HIDDEN_PAUSE: Duration = Duration::from_millis(50);

/// Frames between two reads of the culling counts: a read waits for the GPU. At low frame rates
/// fewer: a read at least every so often.
const CULL_STATS_INTERVAL: usize = 60;
const CULL_STATS_AGE: Duration = Duration::from_secs(2);

/// Longest camera step; a longer one would jump. Above 4 frames a second the camera moves as fast
/// as the panel says.
const LONGEST_STEP: Duration = Duration::from_millis(250);

/// Shown over the first frames, and for how long.
const FIRST_HINT: &str = "drag to look, W A S D to fly, 1 to 8 for places, H for all keys";
const FIRST_HINT_LASTS: Duration = Duration::from_secs(12);
/// How long answers to keys are shown.
const ANSWER_LASTS: Duration = Duration::from_secs(3);

/// Time for the search of places in a frame; an eighth of frames that take longer.
const SEARCH: Duration = Duration::from_millis(3);

/// Time of day at the start, hours: that of the slider until it is moved.
const START_HOURS: f32 = 9.0;

/// Opens the window and runs until it is closed.
pub fn run(args: &Args, started: Instant) -> anyhow::Result<()> {
    let event_loop = EventLoop::new().map_err(|_| {
        // winit's cause names its source file; on every system it means this.
        anyhow!(
            "no display to open a window on: set DISPLAY or WAYLAND_DISPLAY, or draw into a \
            file with --shot FILE.png"
        )
    })?;
    let mut app = App {
        args: args.clone(),
        started,
        display: event_loop.owned_display_handle(),
        running: None,
        failure: None,
    };
    event_loop.run_app(&mut app).context("the window system failed")?;
    let stats = app.running.as_ref().map(Running::stats);
    if let Some(failure) = app.failure {
        return Err(failure);
    }
    if let (Some(path), Some(stats)) = (&args.stats, &stats) {
        write_stats(path, stats)?;
    }
    Ok(())
}

struct App {
    args: Args,
    started: Instant,
    display: OwnedDisplayHandle,
    running: Option<Running>,
    failure: Option<anyhow::Error>,
}

/// State while the window exists.
struct Running {
    window: Arc<Window>,
    gpu: Gpu,
    rebuilds: Rebuilds,
    materials: CustomMaterials,
    surface: WindowSurface,
    renderer: Renderer,
    /// Options of the renderer at the start.
    render_options: RenderOptions,
    overlay: Overlay,
    streamer: WorldStreamer<Box<dyn ChunkStream>>,
    controls: Controls,
    settings: ViewSettings,
    /// Settings at the start.
    first_settings: ViewSettings,
    notice: Option<String>,
    clock: Clock,
    notices: Notices,
    /// The start of the world.
    start: Pose,
    places: Option<PlaceFinder>,
    /// A place to go to once it is found.
    wanted: Option<Place>,
    /// View distance before a place widened it, metres.
    narrow_view_m: Option<u32>,
    modifiers: ModifiersState,
    args: Args,
    /// Whether the search for the start of the announced world is still to begin.
    follows_world: bool,
    /// The search for it, which takes longer than a frame.
    search: Option<Background<Pose>>,
    adapter: String,
    slots: u32,
    show_panel: bool,
    show_keys: bool,
    /// Whether the last frame had panel or keys, which take events.
    has_overlay: bool,
    takes_screenshot: bool,
    times: FrameTimes,
    frames: usize,
    first_image: Option<Duration>,
    drawn: usize,
    instances: usize,
    /// Last culling counts.
    plants: CullStats,
    /// When they were read.
    plants_read: Instant,
    started: Instant,
    last: Instant,
    /// No frame before this time.
    resume_at: Instant,
}

/// What to do after a frame.
enum After {
    Continue,
    Quit,
}

impl ApplicationHandler for App {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.running.is_some() {
            return;
        }
        match Running::start(event_loop, self.display.clone(), &self.args, self.started) {
            Ok(running) => self.running = Some(running),
            Err(error) => self.quit(event_loop, Some(error)),
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(running) = &mut self.running else { return };
        if matches!(event, WindowEvent::RedrawRequested) {
            match running.redraw() {
                Ok(After::Continue) => {}
                Ok(After::Quit) => self.quit(event_loop, None),
                Err(error) => self.quit(event_loop, Some(error)),
            }
        } else if running.event(&event) {
            self.quit(event_loop, None);
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        let Some(running) = &self.running else { return };
        if Instant::now() >= running.resume_at {
            running.window.request_redraw();
            event_loop.set_control_flow(ControlFlow::Poll);
        } else {
            event_loop.set_control_flow(ControlFlow::WaitUntil(running.resume_at));
        }
    }
}

impl App {
    fn quit(&mut self, event_loop: &ActiveEventLoop, failure: Option<anyhow::Error>) {
        self.failure = self.failure.take().or(failure);
        event_loop.exit();
    }
}

impl Running {
    fn start(
        event_loop: &ActiveEventLoop,
        display: OwnedDisplayHandle,
        args: &Args,
        started: Instant,
    ) -> anyhow::Result<Self> {
        let attributes = Window::default_attributes()
            .with_title("Tombolo")
            .with_inner_size(winit::dpi::PhysicalSize::new(args.size.0, args.size.1));
        let window = Arc::new(event_loop.create_window(attributes).context("cannot open a window")?);
        let instance = gpu::instance(Some(Box::new(display)));
        let surface = instance
            .create_surface(Arc::clone(&window))
            .context("cannot draw into this window: draw into a file with --shot FILE.png")?;
        let gpu = pollster::block_on(Gpu::open(instance, Some(&surface)))?;
        let size = window.inner_size();
        let surface = WindowSurface::new(&gpu, surface, (size.width, size.height))?;
        let slots =
            ChunkPool::slots_within(&gpu.device.limits(), ChunkCache::capacity_for(args.chunk_mb << 20));
        let profile = Profile::of(args, gpu.is_software());
        if let Some(notice) = &profile.notice {
            eprintln!("{notice}");
        }
        let options = RenderOptions {
            scene: args.scene,
            size: surface.size(),
            samples: profile.samples,
            format: surface.format,
            slots,
            clipmap_texels: args.clipmap,
        };
        let stream = open_stream(args)?;
        let materials = textures::custom_materials(args)?;
        let now = Instant::now();
        let start = args.pose();
        let settings = ViewSettings {
            tolerance_px: profile.tolerance_px,
            view_distance_m: profile.view_distance_m,
            render: profile.render,
            day: Day { hours: START_HOURS, plays: false },
        };
        Ok(Self {
            renderer: Renderer::with_materials(&gpu, &options, &materials),
            render_options: options,
            materials,
            rebuilds: Rebuilds::new(MOST_REBUILDS),
            overlay: Overlay::new(&gpu, &window, surface.format, args.ui_scale),
            streamer: WorldStreamer::new(stream, slots)
                .fading(ARRIVAL_FADE)
                .with_vertical_scale(args.vertical_scale()),
            controls: if args.scene.is_indoor() {
                Controls::indoors(start, args.orbit, args.scene.orbit_radius_m())
            } else {
                Controls::new(start, args.orbit, args.scene.orbit_radius_m())
            },
            settings,
            first_settings: settings,
            notice: profile.notice,
            clock: Clock::at(args.time),
            notices: Notices::default(),
            start,
            places: None,
            wanted: None,
            narrow_view_m: None,
            modifiers: ModifiersState::empty(),
            follows_world: args.follows_world(),
            search: None,
            args: args.clone(),
            adapter: gpu.name(),
            slots,
            show_panel: true,
            show_keys: false,
            has_overlay: false,
            takes_screenshot: false,
            times: FrameTimes::default(),
            frames: 0,
            first_image: None,
            drawn: 0,
            instances: 0,
            plants: CullStats::default(),
            plants_read: now,
            started,
            last: now,
            resume_at: now,
            window,
            gpu,
            surface,
        })
    }

    /// Takes an event; true to quit.
    fn event(&mut self, event: &WindowEvent) -> bool {
        // As it was before the event: Esc takes the focus from a text field.
        let is_typing = self.has_overlay && self.overlay.is_typing();
        let taken = self.has_overlay && self.overlay.takes(&self.window, event);
        match event {
            WindowEvent::CloseRequested => return true,
            WindowEvent::Resized(size) => self.surface.resize(&self.gpu, (size.width, size.height)),
            WindowEvent::Focused(false) => self.controls.release_all(),
            WindowEvent::ModifiersChanged(modifiers) => self.modifiers = modifiers.state(),
            WindowEvent::KeyboardInput { event: key, .. } => {
                let PhysicalKey::Code(code) = key.physical_key else { return false };
                let is_pressed = key.state == ElementState::Pressed;
                let action = keys::action(code, self.modifiers.control_key(), is_typing);
                match action.filter(|_| is_pressed && !key.repeat) {
                    Some(action) => return self.act(action),
                    // Key releases always pass, or a key would stay down under the panel.
                    None if key.repeat || (taken && is_pressed) => {}
                    None => self.controls.key(code, key.state),
                }
            }
            WindowEvent::MouseInput { state, button, .. } if !taken || *state == ElementState::Released => {
                self.controls.button(*button, *state);
            }
            WindowEvent::CursorMoved { position, .. } => self.controls.pointer(position.x, position.y),
            WindowEvent::MouseWheel { delta, .. } if !taken => self.controls.wheel(*delta),
            _ => {}
        }
        false
    }

    /// Does what a key is for; true to quit.
    fn act(&mut self, action: Action) -> bool {
        let now = Instant::now();
        match action {
            Action::Quit => return true,
            Action::AskQuit => return self.notices.is_second_escape(now),
            Action::Fullscreen => {
                let is_full = self.window.fullscreen().is_some();
                self.window.set_fullscreen((!is_full).then_some(Fullscreen::Borderless(None)));
            }
            Action::Screenshot => self.takes_screenshot = true,
            Action::Pause => {
                self.clock.is_paused = !self.clock.is_paused;
                let line = if self.clock.is_paused { "time stands; Space goes on" } else { "time goes on" };
                self.notices.show(line, now, ANSWER_LASTS);
            }
            Action::ResetView => {
                self.narrow_view();
                self.controls.move_to(self.start);
            }
            Action::Help => self.show_keys = !self.show_keys,
            Action::Panel => {
                self.show_panel = !self.show_panel;
                if !self.show_panel {
                    self.notices.show("F1 shows the panel", now, 2 * ANSWER_LASTS);
                }
            }
            Action::Go(_) if self.args.scene.is_local() => {
                self.notices.show("this scene has no places", now, ANSWER_LASTS);
            }
            Action::Go(place) => self.wanted = Some(place),
        }
        false
    }

    /// Searches places for a small part of a frame, and goes to the wanted one.
    fn visit(&mut self, step: Duration) {
        let Some(land) = self.streamer.cache().land() else { return };
        let scale = self.args.vertical_scale();
        let finder = self.places.get_or_insert_with(|| PlaceFinder::new(*land, scale));
        let begun = Instant::now();
        let longest = SEARCH.max(step / 8);
        while begun.elapsed() < longest && !finder.advance() {}
        let Some(place) = self.wanted else { return };
        if let Some(pose) = finder.get(place) {
            self.wanted = None;
            self.narrow_view();
            let needed_m = place.view_distance_m();
            if needed_m > self.settings.view_distance_m && self.args.view_distance.is_none() {
                self.narrow_view_m = Some(self.settings.view_distance_m);
                self.settings.view_distance_m = needed_m;
            }
            self.controls.move_to(pose);
            self.notices.show(place.label(), Instant::now(), ANSWER_LASTS);
        } else {
            let line = format!("searching: {}", place.label());
            self.notices.show(&line, Instant::now(), ANSWER_LASTS);
        }
    }

    /// Ends the widening of the view by a place.
    fn narrow_view(&mut self) {
        if let Some(view_distance_m) = self.narrow_view_m.take() {
            self.settings.view_distance_m = view_distance_m;
        }
    }

    /// Draws a frame without the panel into a new file.
    fn save_screenshot(&mut self, frame: &FrameData) -> anyhow::Result<()> {
        let (width, height) = self.surface.size();
        let target = OffscreenTarget::with_format(&self.gpu.device, width, height, self.surface.format);
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.renderer.draw(&self.gpu, frame, &mut encoder, &target.view);
        self.gpu.queue.submit([encoder.finish()]);
        let image = target.read(&self.gpu)?;
        let line = match capture::save(Path::new("."), &image) {
            Ok(path) => match std::path::absolute(&path) {
                Ok(path) => format!("wrote {}", path.display()),
                Err(_) => format!("wrote {}", path.display()),
            },
            Err(error) => format!("{error:#}"),
        };
        self.notices.show(&line, Instant::now(), 2 * ANSWER_LASTS);
        Ok(())
    }

    /// Draws a frame; on a new device if the present one is lost.
    fn redraw(&mut self) -> anyhow::Result<After> {
        match self.draw_frame() {
            Err(error) => {
                let error = error.downcast::<GpuError>()?;
                let cause = self.rebuilds.begin(&self.gpu, error)?;
                self.rebuild()?;
                let line = format!("the GPU failed and was opened again: {cause}");
                self.notices.show(&line, Instant::now(), FIRST_HINT_LASTS);
                Ok(After::Continue)
            }
            drawn => {
                self.rebuilds.frame_drawn();
                drawn
            }
        }
    }

    /// Opens a new device with its surface and renderer, and uploads the chunk cache.
    fn rebuild(&mut self) -> anyhow::Result<()> {
        let surface = self.gpu.instance.create_surface(Arc::clone(&self.window))?;
        self.gpu = pollster::block_on(self.gpu.reopen(Some(&surface)))?;
        let size = self.window.inner_size();
        self.surface = WindowSurface::new(&self.gpu, surface, (size.width, size.height))?;
        let options =
            RenderOptions { size: self.surface.size(), format: self.surface.format, ..self.render_options };
        self.renderer = Renderer::with_materials(&self.gpu, &options, &self.materials);
        self.overlay = Overlay::new(&self.gpu, &self.window, self.surface.format, self.args.ui_scale);
        let (gpu, renderer) = (&self.gpu, &mut self.renderer);
        self.streamer.cache().residents().for_each(|chunk| renderer.upload(gpu, chunk));
        self.adapter = self.gpu.name();
        Ok(())
    }

    fn draw_frame(&mut self) -> anyhow::Result<After> {
        self.gpu.check()?;
        let (texture, view) = match self.surface.next(&self.gpu) {
            NextTexture::Ready(texture, view) => (texture, view),
            NextTexture::Skip => {
                self.resume_at = Instant::now() + HIDDEN_PAUSE;
                return Ok(After::Continue);
            }
            NextTexture::Lost => {
                let surface = self.gpu.instance.create_surface(Arc::clone(&self.window))?;
                let size = self.window.inner_size();
                self.surface = WindowSurface::new(&self.gpu, surface, (size.width, size.height))?;
                return Ok(After::Continue);
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
            self.streamer.update(&view_params, self.started.elapsed(), ARRIVALS_PER_FRAME, |chunk| {
                renderer.upload(gpu, chunk);
            });
        if self.follows_world
            && let Some(land) = self.streamer.cache().land().copied()
        {
            self.follows_world = false;
            let args = self.args.clone();
            self.search = Some(Background::start("tombolo-start", move || args.start_in(&land))?);
        }
        if let Some(search) = &mut self.search
            && let Some(start) = search.poll()?
        {
            self.search = None;
            // A user who has moved since the window opened stays there.
            if self.controls.is_orbiting() || self.controls.pose() == self.start {
                self.controls.move_to(start);
            }
            self.start = start;
        }
        let pose = clearance::raised(view_params.pose, self.streamer.cache(), &selection.drawn);
        let view_params = ViewParams { pose, ..view_params };
        let frame = view_params.frame(self.args.scene, self.streamer.cache(), &selection);
        (self.drawn, self.instances) = (frame.chunks, frame.instances.len());
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        renderer.fill_clipmap(gpu, &frame, TILES_PER_FRAME);
        renderer.trace_shadows(gpu, &frame, PER_FRAME, &mut encoder);
        renderer.draw(gpu, &frame, &mut encoder, &view);
        let now = Instant::now();
        // Also without the panel: nothing more will come.
        if let Link::Refused(cause) = self.streamer.link() {
            self.notices.show(cause, now, ANSWER_LASTS);
        }
        let has_notices = self.notices.shown(now).next().is_some();
        self.has_overlay = self.show_panel || self.show_keys;
        if self.has_overlay || has_notices {
            let readings = Readings {
                times: &self.times,
                drawn: self.drawn,
                resident: self.streamer.cache().len(),
                capacity: self.slots,
                triangles: self.instances as u64 * TRIANGLES_PER_INSTANCE,
                plants: self.plants,
                missing: selection.missing,
                traffic: self.streamer.stream().traffic(),
                missed: self.streamer.missed(),
                last_miss: self.streamer.last_miss(),
                delivery: self.args.delivery,
                levels: self.streamer.cache().level_histogram(),
                local: self.args.scene.panel_legend(),
                link: self.streamer.link(),
                now: self.started.elapsed(),
                camera: view_params.pose.to_string(),
                speed_m: self.controls.speed_m(),
                orbiting: self.controls.is_orbiting(),
                drawn_tolerance_px: self.streamer.tolerance_px(&view_params),
                adapter: &self.adapter,
                notice: self.notice.as_deref(),
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
                (self.settings, self.narrow_view_m) = (self.first_settings, None);
            }
        }
        gpu.queue.submit([encoder.finish()]);
        if self.frames.is_multiple_of(CULL_STATS_INTERVAL) || now - self.plants_read > CULL_STATS_AGE {
            self.plants = self.read_cull_stats();
            self.plants_read = now;
        }
        self.window.pre_present_notify();
        gpu.queue.present(texture);
        self.times.push(step);
        self.frames += 1;
        if self.first_image.is_none() {
            self.first_image = Some(self.started.elapsed());
            self.notices.show(FIRST_HINT, Instant::now(), FIRST_HINT_LASTS);
        }
        if std::mem::take(&mut self.takes_screenshot) {
            self.save_screenshot(&frame)?;
        }
        let wanted = self.args.frames.is_some_and(|frames| self.frames >= frames as usize);
        Ok(if wanted { After::Quit } else { After::Continue })
    }

    /// Moves the camera by the time since the last frame, which it returns.
    fn step(&mut self) -> Duration {
        let now = Instant::now();
        let step = now - self.last;
        self.last = now;
        let eye = self.controls.pose().eye();
        let ground_m = self.streamer.cache().ground(eye.units[0], eye.units[2]).map(|h| f64::from(h) / 256.0);
        self.controls.step(step.min(LONGEST_STEP).as_secs_f64(), ground_m);
        step
    }

    /// Reads the culling counts; a failed GPU is reported by the next frame.
    fn read_cull_stats(&self) -> CullStats {
        let vegetation = self.renderer.vegetation().filter(|_| self.settings.render.plants.any());
        vegetation.and_then(|vegetation| vegetation.read_stats(&self.gpu).ok()).unwrap_or_default()
    }

    fn stats(&self) -> Stats {
        let (milestones, traffic) = (self.streamer.milestones(), self.streamer.stream().traffic());
        let resident = self.streamer.cache().len();
        Stats {
            adapter: self.adapter.clone(),
            frames: self.frames,
            chunks_drawn: self.drawn,
            triangles: self.instances as u64 * TRIANGLES_PER_INSTANCE,
            terrain_draws: self.renderer.terrain_draws(),
            plants_drawn: self.plants.clumps,
            plants_lost: self.plants.clumps_lost,
            plant_blocks_lost: self.plants.blocks_lost,
            gpu_bytes_per_chunk: self.renderer.bytes_per_chunk(),
            delivery: if self.args.scene.is_local() { "none" } else { self.args.delivery.name() },
            bytes_received: traffic.bytes_received,
            bad_chunks: traffic.bad_chunks,
            refused_chunks: traffic.refused_chunks,
            retried_chunks: traffic.retried_chunks,
            gpu_rebuilds: self.rebuilds.done(),
            seconds_to_first_chunk: milestones.first_chunk.map(|at| at.as_secs_f64()),
            seconds_to_complete_view: milestones.complete_view.map(|at| at.as_secs_f64()),
            seconds_to_first_picture: self.first_image.map(|at| at.as_secs_f64()),
            frame_ms_p50: self.times.quantile_ms(0.5, usize::MAX),
            frame_ms_p99: self.times.quantile_ms(0.99, usize::MAX),
            chunks_resident: resident,
            chunk_bytes_resident: resident * SLOT_BYTES,
            chunk_bytes_budget: self.slots as usize * SLOT_BYTES,
            tolerance_px: self.settings.tolerance_px,
            camera: self.controls.pose().to_string(),
        }
    }
}
