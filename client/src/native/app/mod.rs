//! The window: winit's event loop with a streamer, a renderer and a panel.

pub mod controls;
pub mod overlay;
pub mod panel;

use crate::cache::ChunkCache;
use crate::cache::SLOT_BYTES;
use crate::camera::Projection;
use crate::features::terrain::pool::ChunkPool;
use crate::features::terrain_shadow::pass::PER_FRAME;
use crate::features::vegetation::gpu_cull::CullStats;
use crate::frame::TRIANGLES_PER_INSTANCE;
use crate::gpu;
use crate::gpu::Gpu;
use crate::gpu::surface::{NextTexture, WindowSurface};
use crate::native::args::Args;
use crate::native::screenshot::{open_stream, write_stats};
use crate::native::textures;
use crate::renderer::{RenderOptions, Renderer};
use crate::stats::{FrameTimes, Stats};
use crate::stream::ChunkStream;
use crate::stream::streamer::WorldStreamer;
use crate::view::ViewParams;
use anyhow::{Context as _, anyhow};
use controls::Controls;
use overlay::Overlay;
use panel::{Readings, ViewSettings};
use std::sync::Arc;
use std::time::{Duration, Instant};
use winit::application::ApplicationHandler;
use winit::event::{ElementState, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, OwnedDisplayHandle};
use winit::keyboard::{KeyCode, PhysicalKey};
use winit::window::{Window, WindowId};

/// Chunks inserted per frame: about 2 ms of uploads, so that bursts do not drop frames.
const ARRIVALS_PER_FRAME: usize = 48;

/// Fade-in time of finer chunks: long enough to hide popping, short enough not to be noticed.
const ARRIVAL_FADE: Duration = Duration::from_millis(250);

/// Pause while a window cannot be drawn into.
const HIDDEN_PAUSE: Duration = Duration::from_millis(50);

/// Frames between two reads of the culling counts: a read waits for the GPU.
const CULL_STATS_INTERVAL: usize = 60;

/// Longest camera step; a longer one would jump.
const LONGEST_STEP: Duration = Duration::from_millis(200);

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
    surface: WindowSurface,
    renderer: Renderer,
    overlay: Overlay,
    streamer: WorldStreamer<Box<dyn ChunkStream>>,
    controls: Controls,
    settings: ViewSettings,
    args: Args,
    /// Whether the camera still waits for the start of the announced world.
    follows_world: bool,
    adapter: String,
    slots: u32,
    show_panel: bool,
    times: FrameTimes,
    frames: usize,
    first_image: Option<Duration>,
    drawn: usize,
    instances: usize,
    /// Last culling counts.
    plants: CullStats,
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
        let software = gpu.adapter.get_info().device_type == wgpu::DeviceType::Cpu;
        let options = RenderOptions {
            scene: args.scene,
            size: surface.size(),
            samples: args.samples.unwrap_or(if software { 1 } else { 4 }),
            format: surface.format,
            slots,
        };
        let stream = open_stream(args)?;
        let now = Instant::now();
        Ok(Self {
            renderer: Renderer::with_materials(&gpu, &options, &textures::custom_materials(args)?),
            overlay: Overlay::new(&gpu, &window, surface.format),
            streamer: WorldStreamer::new(stream, slots)
                .fading(ARRIVAL_FADE)
                .with_vertical_scale(args.vertical_scale()),
            controls: if args.scene.is_indoor() {
                Controls::indoors(args.pose(), args.orbit, args.scene.orbit_radius_m())
            } else {
                Controls::new(args.pose(), args.orbit, args.scene.orbit_radius_m())
            },
            settings: ViewSettings {
                tolerance_px: args.tolerance,
                view_distance_m: args.view_distance,
                render: args.render_settings(),
            },
            follows_world: args.follows_world(),
            args: args.clone(),
            adapter: gpu.name(),
            slots,
            show_panel: true,
            times: FrameTimes::default(),
            frames: 0,
            first_image: None,
            drawn: 0,
            instances: 0,
            plants: CullStats::default(),
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
        let taken = self.show_panel && self.overlay.takes(&self.window, event);
        match event {
            WindowEvent::CloseRequested => return true,
            WindowEvent::Resized(size) => self.surface.resize(&self.gpu, (size.width, size.height)),
            WindowEvent::Focused(false) => self.controls.release_all(),
            WindowEvent::KeyboardInput { event: key, .. } => {
                if let PhysicalKey::Code(code) = key.physical_key {
                    let pressed = key.state == ElementState::Pressed && !key.repeat;
                    match code {
                        KeyCode::Escape => return true,
                        KeyCode::F1 if pressed => self.show_panel = !self.show_panel,
                        // Key releases always pass, or a key would stay down under the panel.
                        _ if key.repeat || (taken && pressed) => {}
                        _ => self.controls.key(code, key.state),
                    }
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

    fn redraw(&mut self) -> anyhow::Result<After> {
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
        let (width, height) = self.surface.size();
        self.renderer.resize(&self.gpu, (width, height));
        let view_params = ViewParams {
            pose: self.controls.pose(),
            projection: Projection { fov_deg: self.args.fov, width, height },
            view_distance_m: self.settings.view_distance_m,
            tolerance_px: self.settings.tolerance_px,
            time_s: self.started.elapsed().as_secs_f32(),
            settings: self.settings.render,
        };
        let (gpu, renderer) = (&self.gpu, &mut self.renderer);
        let selection =
            self.streamer.update(&view_params, self.started.elapsed(), ARRIVALS_PER_FRAME, |chunk| {
                renderer.upload(gpu, chunk);
            });
        if self.follows_world
            && let Some(land) = self.streamer.cache().land()
        {
            self.follows_world = false;
            let start = self.args.scene.start_in(land);
            // A user who has moved since the window opened stays there.
            if self.controls.is_orbiting() || self.controls.pose() == self.args.pose() {
                self.controls.move_to(start);
            }
        }
        let frame = view_params.frame(self.args.scene, self.streamer.cache(), &selection);
        (self.drawn, self.instances) = (frame.chunks, frame.instances.len());
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        renderer.trace_shadows(gpu, &frame, PER_FRAME, &mut encoder);
        renderer.draw(gpu, &frame, &mut encoder, &view);
        if self.show_panel {
            let traffic = self.streamer.stream().traffic();
            let readings = Readings {
                times: &self.times,
                drawn: self.drawn,
                resident: self.streamer.cache().len(),
                capacity: self.slots,
                triangles: self.instances as u64 * TRIANGLES_PER_INSTANCE,
                plants: self.plants,
                missing: selection.missing,
                bytes_received: traffic.bytes_received,
                delivery: self.args.delivery,
                credits: traffic.credits,
                levels: self.streamer.cache().level_histogram(),
                local: self.args.scene.panel_legend(),
                link: self.streamer.link(),
                now: self.started.elapsed(),
                camera: view_params.pose.to_string(),
                speed_m: self.controls.speed_m(),
                orbiting: self.controls.is_orbiting(),
                drawn_tolerance_px: self.streamer.tolerance_px(&view_params),
                adapter: &self.adapter,
            };
            let settings = &mut self.settings;
            let painted = self.overlay.run(&self.window, (width, height), |ctx| {
                panel::show(ctx, &readings, settings);
            });
            self.overlay.paint(gpu, painted, &mut encoder, &view);
        }
        gpu.queue.submit([encoder.finish()]);
        if self.frames.is_multiple_of(CULL_STATS_INTERVAL) {
            self.plants = self.read_cull_stats();
        }
        self.window.pre_present_notify();
        gpu.queue.present(texture);
        self.times.push(step);
        self.frames += 1;
        self.first_image.get_or_insert_with(|| self.started.elapsed());
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
        let milestones = self.streamer.milestones();
        let resident = self.streamer.cache().len();
        Stats {
            adapter: self.adapter.clone(),
            frames: self.frames,
            chunks_drawn: self.drawn,
            triangles: self.instances as u64 * TRIANGLES_PER_INSTANCE,
            terrain_draws: self.renderer.terrain_draws(),
            plants_drawn: self.plants.clumps,
            plants_lost: self.plants.clumps_lost,
            gpu_bytes_per_chunk: self.renderer.bytes_per_chunk(),
            delivery: if self.args.scene.is_local() { "none" } else { self.args.delivery.name() },
            bytes_received: self.streamer.stream().traffic().bytes_received,
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
