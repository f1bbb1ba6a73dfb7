//! The open window: a streamer, a renderer and a panel. Events are in `input`, frames in `frame`, a
//! new device in place of a lost one in `rebuild`.

mod frame;
mod input;
mod rebuild;

use super::clock::{Clock, Day};
use super::controls::Controls;
use super::notices::Notices;
use super::overlay::Overlay;
use super::view_settings::ViewSettings;
use crate::cache::{ChunkCache, SLOT_BYTES};
use crate::camera::Pose;
use crate::features::materials::CustomMaterials;
use crate::features::terrain::pool::ChunkPool;
use crate::features::vegetation::gpu_cull::CullStats;
use crate::features::vegetation::stats::StatsRead;
use crate::frame::TRIANGLES_PER_INSTANCE;
use crate::gpu::rebuild::{MOST_REBUILDS, Rebuilds};
use crate::gpu::surface::WindowSurface;
use crate::gpu::{self, Gpu};
use crate::native::args::Args;
use crate::native::background::Background;
use crate::native::profile::Profile;
use crate::native::screenshot::open_stream;
use crate::native::textures;
use crate::renderer::{RenderOptions, Renderer};
use crate::scene::places::{Place, PlaceFinder};
use crate::settings::SunPosition;
use crate::stats::{FrameTimes, Stats};
use crate::stream::ChunkStream;
use crate::stream::streamer::WorldStreamer;
use crate::view::ViewParams;
use anyhow::Context as _;
use std::sync::Arc;
use std::time::{Duration, Instant};
use terrain::WorldDigest;
use winit::event_loop::{ActiveEventLoop, OwnedDisplayHandle};
use winit::keyboard::ModifiersState;
use winit::window::Window;

/// Fade-in time of finer chunks: long enough to hide popping, short enough not to be noticed.
const ARRIVAL_FADE: Duration = Duration::from_millis(250);

/// Time on screen of a short notice.
const NOTICE_DURATION: Duration = Duration::from_secs(3);

/// Time on screen of the first hint and of the notice that the GPU was opened again.
const LONG_NOTICE_DURATION: Duration = Duration::from_secs(12);

/// State while the window exists.
pub struct WindowState {
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
    /// Restored when the view is reset.
    initial_settings: ViewSettings,
    /// Line of the panel about the driver.
    driver_notice: Option<String>,
    clock: Clock,
    /// Short-lived lines over the picture.
    notices: Notices,
    /// World in which `start_pose` and `places` were searched; none before a server announced it.
    world: Option<WorldDigest>,
    start_pose: Pose,
    places: Option<PlaceFinder>,
    /// A place to go to once it is found.
    wanted: Option<Place>,
    /// View distance before a place widened it, metres, restored when the view is reset or another
    /// place is visited.
    view_distance_before_place_m: Option<u32>,
    /// That of the options.
    initial_view_distance_before_place_m: Option<u32>,
    modifiers: ModifiersState,
    args: Args,
    /// The search for the start of the announced world, which takes longer than a frame.
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
    first_picture: Option<Duration>,
    chunks_drawn: usize,
    instances: usize,
    /// The view of the last frame.
    last_view: Option<ViewParams>,
    /// The newest counts of culling that arrived.
    cull_stats: CullStats,
    /// A copy of newer counts that the GPU has not finished.
    cull_stats_pending: Option<StatsRead>,
    /// When the newest copy was recorded.
    cull_stats_copied_at: Instant,
    program_started: Instant,
    last_frame_at: Instant,
    no_frame_before: Instant,
}

/// What the event loop does after a frame.
pub enum FrameOutcome {
    /// Draw the next one.
    Continue,
    /// End the program.
    Quit,
}

impl WindowState {
    /// Opens the window, the GPU and the stream.
    ///
    /// # Errors
    /// One of them cannot be opened.
    pub fn start(
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
            anisotropy: profile.anisotropy,
            format: surface.format,
            slots,
            clipmap_texels: args.clipmap,
        };
        let stream = open_stream(args)?;
        let materials = textures::custom_materials(args)?;
        let now = Instant::now();
        let start = args.pose();
        let mut clock = Clock::at(args.time);
        clock.is_paused = args.window_test.last_frame.is_some();
        let sun = profile.render.sun.unwrap_or_else(|| SunPosition::of(args.scene.light().sun));
        let settings = ViewSettings {
            tolerance_px: profile.tolerance_px,
            view_distance_m: profile.view_distance_m,
            render: profile.render,
            day: Day::nearest_to(sun),
        };
        Ok(Self {
            renderer: Renderer::with_materials(&gpu, &options, &materials),
            render_options: options,
            materials,
            rebuilds: Rebuilds::new(MOST_REBUILDS),
            overlay: Overlay::new(&gpu, &window, surface.format, args.ui_scale()),
            streamer: WorldStreamer::new(stream, slots)
                .fading(ARRIVAL_FADE)
                .with_vertical_scale(args.vertical_scale()),
            controls: if args.scene.is_indoor() {
                Controls::indoors(start, args.orbit, args.scene.orbit_radius_m())
            } else {
                Controls::new(start, args.orbit, args.scene.orbit_radius_m())
            },
            settings,
            initial_settings: settings,
            driver_notice: profile.notice,
            clock,
            notices: Notices::default(),
            world: None,
            start_pose: start,
            places: None,
            wanted: None,
            view_distance_before_place_m: profile.narrow_view_m,
            initial_view_distance_before_place_m: profile.narrow_view_m,
            modifiers: ModifiersState::empty(),
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
            first_picture: None,
            chunks_drawn: 0,
            instances: 0,
            last_view: None,
            cull_stats: CullStats::default(),
            cull_stats_pending: None,
            cull_stats_copied_at: now,
            program_started: started,
            last_frame_at: now,
            no_frame_before: now,
            window,
            gpu,
            surface,
        })
    }

    /// Asks the window system for a frame.
    pub fn request_redraw(&self) {
        self.window.request_redraw();
    }

    /// No frame is drawn before this time.
    #[must_use]
    pub const fn resume_at(&self) -> Instant {
        self.no_frame_before
    }

    /// Measurements so far.
    #[must_use]
    pub fn stats(&self) -> Stats {
        let (milestones, traffic) = (self.streamer.milestones(), self.streamer.stream().traffic());
        let delivery = self.streamer.stream().delivery();
        let (resident, view) = (self.streamer.cache().len(), self.last_view.as_ref());
        Stats {
            adapter: self.adapter.clone(),
            frames: self.frames,
            chunks_drawn: self.chunks_drawn,
            triangles: self.instances as u64 * TRIANGLES_PER_INSTANCE,
            terrain_draws: self.renderer.terrain_draws(),
            plants_drawn: self.cull_stats.clumps,
            plants_lost: self.cull_stats.clumps_lost,
            plant_blocks_lost: self.cull_stats.blocks_lost,
            gpu_bytes_per_chunk: self.renderer.bytes_per_chunk(),
            delivery: if self.args.scene.is_local() { "none" } else { delivery.name() },
            bytes_received: traffic.bytes_received,
            bad_chunks: traffic.bad_chunks,
            refused_chunks: traffic.refused_chunks,
            retried_chunks: traffic.retried_chunks,
            gpu_rebuilds: self.rebuilds.done(),
            seconds_to_first_chunk: milestones.first_chunk.map(|at| at.as_secs_f64()),
            seconds_to_complete_view: milestones.complete_view.map(|at| at.as_secs_f64()),
            seconds_to_first_picture: self.first_picture.map(|at| at.as_secs_f64()),
            frame_ms_p50: self.times.quantile_ms(0.5, usize::MAX),
            frame_ms_p99: self.times.quantile_ms(0.99, usize::MAX),
            chunks_resident: resident,
            chunk_bytes_resident: resident * SLOT_BYTES,
            chunk_bytes_budget: self.slots as usize * SLOT_BYTES,
            tolerance_px: view.map_or(self.settings.tolerance_px, |view| self.streamer.tolerance_px(view)),
            camera: format!("{:.4}", view.map_or(self.controls.pose(), |view| view.pose)),
        }
    }
}
