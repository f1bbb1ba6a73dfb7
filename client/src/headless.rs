//! Headless rendering: completes the view from a stream, draws and times it, reads it back. Local
//! scenes need no stream.

use crate::cache::ChunkCache;
use crate::cache::SLOT_BYTES;
use crate::camera::{Pose, Projection};
use crate::features::materials::CustomMaterials;
use crate::features::terrain::pool::ChunkPool;
use crate::features::terrain_clipmap::textures::ALL_TILES;
use crate::features::terrain_clipmap::window::STANDARD_TEXELS;
use crate::features::terrain_shadow::Quota;
use crate::features::terrain_shadow::pass::PER_FRAME;
use crate::frame::TRIANGLES_PER_INSTANCE;
use crate::gpu::rebuild::{MOST_REBUILDS, Rebuilds};
use crate::gpu::{Gpu, GpuError, Image, OffscreenTarget, offscreen};
use crate::lod::clearance;
use crate::renderer::{RenderOptions, Renderer};
use crate::scene::Scene;
use crate::scene::places::{self, Place};
use crate::settings::RenderSettings;
use crate::stats::{FrameTimes, Stats};
use crate::stream::streamer::{Link, WorldStreamer};
use crate::stream::{ChunkStream, NullStream};
use crate::view::ViewParams;
use std::time::{Duration, Instant};

/// Untimed frames, in which pipelines compile and caches fill.
const WARM_UP_FRAMES: u32 = 3;

/// Events of the stream in one frame: a server that sends without end must not keep a picture from
/// being drawn.
const EVENTS_PER_FRAME: usize = 4096;

/// Failed first connections after which there is no server.
const FIRST_ATTEMPTS: u32 = 3;

/// Interval between polls of the stream while the view fills.
const POLL_PAUSE: Duration = Duration::from_millis(2);

/// A camera that never turns needs no shadows of invisible chunks.
const VISIBLE_PER_FRAME: Quota = Quota { hidden: 0, ..PER_FRAME };

/// Options of a rendering.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// The scene.
    pub scene: Scene,
    /// Position and direction of the camera.
    pub pose: Pose,
    /// Whether the camera moves to the scene's start in the world that a server announces.
    pub follows_world: bool,
    /// Place of the announced world that it moves to in place of the start.
    pub place: Option<Place>,
    /// Field of view and image size.
    pub projection: Projection,
    /// View distance, metres.
    pub view_distance_m: u32,
    /// Tolerated screen error, pixels.
    pub tolerance_px: f64,
    /// Memory for chunks, bytes, CPU and GPU together.
    pub chunk_bytes: usize,
    /// Texels along a side of each level of the terrain clipmap.
    pub clipmap_texels: u32,
    /// Samples per pixel, 1 or 4.
    pub samples: u32,
    /// Anisotropy of the filter of materials, 1 (none) to 16. Drivers filter alike with 1 only.
    pub anisotropy: u16,
    /// Frames to time, at least 1.
    pub frames: u32,
    /// Orbit step between two frames, degrees; 0 stands still.
    pub orbit_step_deg: f64,
    /// Animation time of the first frame, seconds; every further frame adds 1/60.
    pub time_s: f32,
    /// Render settings.
    pub settings: RenderSettings,
    /// Vertical scale of the land, 0.25 to 4.
    pub vertical_scale: f64,
    /// Custom materials.
    pub materials: CustomMaterials,
    /// Time limit for the complete view.
    pub timeout: Duration,
    /// Devices that may be opened in place of lost ones.
    pub gpu_rebuilds: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            scene: Scene::Island,
            pose: Scene::Island.start(),
            follows_world: false,
            place: None,
            projection: Projection { fov_deg: 60.0, width: 1280, height: 720 },
            view_distance_m: 8000,
            tolerance_px: 2.0,
            chunk_bytes: 128 << 20,
            clipmap_texels: STANDARD_TEXELS,
            samples: 4,
            anisotropy: 1,
            frames: 1,
            orbit_step_deg: 0.0,
            time_s: 0.0,
            settings: RenderSettings::default(),
            vertical_scale: 1.0,
            materials: CustomMaterials::default(),
            timeout: Duration::from_secs(60),
            gpu_rebuilds: MOST_REBUILDS,
        }
    }
}

/// Why there is no image.
#[derive(Debug, thiserror::Error)]
pub enum HeadlessError {
    /// The GPU.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// No session was established, or it ended for good.
    #[error("{0}")]
    Stream(String),
    /// The server refused the view.
    #[error("the server refused the view: {0}")]
    Refused(String),
    /// The view was not complete in time.
    #[error("the view was not complete after {seconds} s ({state}): allow more time with --timeout")]
    Timeout {
        /// The limit.
        seconds: u64,
        /// How far it got.
        state: String,
    },
    /// The server serves another world than that of the loaded view.
    #[error("the server changed its world while the picture was drawn: take it again")]
    WorldChanged,
    /// The view was not complete in time, and the session is lost.
    #[error("the view was not complete after {seconds} s ({state}), and the server is gone: {cause}")]
    Lost {
        /// The limit.
        seconds: u64,
        /// How far it got.
        state: String,
        /// Cause of the session's end, and what to do.
        cause: String,
    },
}

/// Progress of the view, for display.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// Chunks in memory.
    pub resident: usize,
    /// Chunks drawn coarser than wanted.
    pub missing: usize,
    /// Bytes received.
    pub bytes_received: u64,
    /// The session's state.
    pub link: Link,
}

/// Renders a local scene: no stream, no chunks. `started` is the start of the stats' clock.
///
/// # Errors
/// There is no GPU, or it fails. A scene that is not local is drawn without land.
pub fn render_local(options: &Options, started: Instant) -> Result<(Image, Stats), HeadlessError> {
    draw(&Gpu::open_blocking()?, options.clone(), NullStream, started, |_, _| Ok(()))
}

/// Completes the view and renders it. `started` is the start of the stats' clock.
pub fn render(
    options: &Options,
    stream: impl ChunkStream,
    started: Instant,
    progress: impl FnMut(&Progress),
) -> Result<(Image, Stats), HeadlessError> {
    render_on(&Gpu::open_blocking()?, options, stream, started, progress)
}

/// [`render`] on an open GPU; of a local scene as [`render_local`].
pub fn render_on(
    gpu: &Gpu,
    options: &Options,
    stream: impl ChunkStream,
    started: Instant,
    mut progress: impl FnMut(&Progress),
) -> Result<(Image, Stats), HeadlessError> {
    if options.scene.is_local() {
        return draw(gpu, options.clone(), NullStream, started, |_, _| Ok(()));
    }
    draw(gpu, options.clone(), stream, started, |streamer, options| {
        fill(streamer, options, started, &mut progress)?;
        // The ground height under the eye is known now; a raised eye needs other chunks.
        fill(streamer, options, started, &mut progress)
    })
}

/// Fills the cache, then draws; again on a new device, from the cache, if the device is lost. The
/// cache first, so that an impossible view fails before materials and pipelines are built.
fn draw<F: ChunkStream>(
    gpu: &Gpu,
    mut options: Options,
    stream: F,
    started: Instant,
    fill: impl FnOnce(&mut WorldStreamer<F>, &mut Options) -> Result<(), HeadlessError>,
) -> Result<(Image, Stats), HeadlessError> {
    let requested = if options.scene.is_local() { 1 } else { ChunkCache::capacity_for(options.chunk_bytes) };
    let slots = ChunkPool::slots_within(&gpu.device.limits(), requested);
    let mut streamer = WorldStreamer::new(stream, slots).with_vertical_scale(options.vertical_scale);
    fill(&mut streamer, &mut options)?;
    let mut rebuilds = Rebuilds::new(options.gpu_rebuilds);
    let mut reopened: Option<Gpu> = None;
    loop {
        let gpu = reopened.as_ref().unwrap_or(gpu);
        match draw_frames(gpu, &options, &mut streamer, (slots, &rebuilds), started) {
            Err(HeadlessError::Gpu(error)) => {
                rebuilds.begin(gpu, error)?;
                reopened = Some(pollster::block_on(gpu.reopen(None))?);
            }
            drawn => return drawn,
        }
    }
}

/// Creates the renderer, uploads the cache, draws, times and reads back.
fn draw_frames(
    gpu: &Gpu,
    options: &Options,
    streamer: &mut WorldStreamer<impl ChunkStream>,
    (slots, rebuilds): (u32, &Rebuilds),
    started: Instant,
) -> Result<(Image, Stats), HeadlessError> {
    let size = (options.projection.width, options.projection.height);
    let mut renderer = Renderer::with_materials(
        gpu,
        &RenderOptions {
            scene: options.scene,
            size,
            samples: options.samples,
            anisotropy: options.anisotropy,
            format: offscreen::IMAGE_FORMAT,
            slots,
            clipmap_texels: options.clipmap_texels,
        },
        &options.materials,
    );
    let target = OffscreenTarget::new(&gpu.device, size.0, size.1);
    streamer.cache().residents().for_each(|chunk| renderer.upload(gpu, chunk));

    let world = streamer.world();
    let mut times = FrameTimes::default();
    let (mut drawn, mut instances) = (0, 0);
    let mut camera = String::new();
    let mut first_image = None;
    for index in 0..WARM_UP_FRAMES + options.frames.max(1) {
        let timed = index.checked_sub(WARM_UP_FRAMES);
        let begun = Instant::now();
        let view = options.view(timed.unwrap_or(0), streamer.cache());
        let selection =
            streamer.update(&view, started.elapsed(), EVENTS_PER_FRAME, |chunk| renderer.upload(gpu, chunk));
        if streamer.world() != world {
            return Err(HeadlessError::WorldChanged);
        }
        let pose = clearance::raised(view.pose, streamer.cache(), &selection.drawn);
        let view = ViewParams { pose, ..view };
        let frame = view.frame(options.scene, streamer.cache(), &selection);
        (drawn, instances) = (frame.chunks, frame.instances.len());
        camera = format!("{:.4}", view.pose);
        if timed.is_none() {
            // Shadows of a still camera are complete before timing starts; shadows that change in
            // timed frames are timed.
            renderer.finish_shading(gpu, &frame)?;
        }
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        renderer.fill_clipmap(gpu, &frame, ALL_TILES);
        let pending = renderer.trace_shadows(gpu, &frame, VISIBLE_PER_FRAME, &mut encoder);
        renderer.draw(gpu, &frame, &mut encoder, &target.view);
        gpu.queue.submit([encoder.finish()]);
        gpu.wait()?;
        first_image.get_or_insert_with(|| started.elapsed());
        if timed.is_some() {
            times.push(begun.elapsed());
        }
        if pending > 0 && index + 1 == WARM_UP_FRAMES + options.frames.max(1) {
            // The kept image has all shadows, whatever the quota per frame was.
            renderer.finish_shading(gpu, &frame)?;
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            renderer.draw(gpu, &frame, &mut encoder, &target.view);
            gpu.queue.submit([encoder.finish()]);
            gpu.wait()?;
        }
    }
    let image = target.read(gpu)?;
    let cull_stats =
        renderer.vegetation().map(|vegetation| vegetation.read_stats(gpu)).transpose()?.unwrap_or_default();
    let (milestones, traffic) = (streamer.milestones(), streamer.stream().traffic());
    let resident = streamer.cache().len();
    let stats = Stats {
        adapter: gpu.name(),
        frames: options.frames.max(1) as usize,
        chunks_drawn: drawn,
        triangles: instances as u64 * TRIANGLES_PER_INSTANCE,
        terrain_draws: renderer.terrain_draws(),
        plants_drawn: cull_stats.clumps,
        plants_lost: cull_stats.clumps_lost,
        plant_blocks_lost: cull_stats.blocks_lost,
        gpu_bytes_per_chunk: renderer.bytes_per_chunk(),
        delivery: if options.scene.is_local() { "none" } else { streamer.stream().delivery().name() },
        bytes_received: traffic.bytes_received,
        bad_chunks: traffic.bad_chunks,
        refused_chunks: traffic.refused_chunks,
        retried_chunks: traffic.retried_chunks,
        gpu_rebuilds: rebuilds.done(),
        seconds_to_first_chunk: milestones.first_chunk.map(|at| at.as_secs_f64()),
        seconds_to_complete_view: milestones.complete_view.map(|at| at.as_secs_f64()),
        seconds_to_first_picture: first_image.map(|at| at.as_secs_f64()),
        frame_ms_p50: times.quantile_ms(0.5, usize::MAX),
        frame_ms_p99: times.quantile_ms(0.99, usize::MAX),
        chunks_resident: resident,
        chunk_bytes_resident: resident * SLOT_BYTES,
        chunk_bytes_budget: slots as usize * SLOT_BYTES,
        tolerance_px: streamer.tolerance_px(&options.view(0, streamer.cache())),
        camera,
    };
    Ok((image, stats))
}

/// Polls the stream until the view is complete.
fn fill(
    streamer: &mut WorldStreamer<impl ChunkStream>,
    options: &mut Options,
    started: Instant,
    progress: &mut impl FnMut(&Progress),
) -> Result<(), HeadlessError> {
    let mut view = options.view(0, streamer.cache());
    let mut lost = None;
    loop {
        // There is no renderer yet: it uploads everything at once when it is created.
        let selection = streamer.update(&view, started.elapsed(), 64, |_| ());
        if let Some(land) = streamer.cache().land().filter(|_| options.follows_world) {
            let pose = match options.place {
                Some(place) => places::find(place, land, options.vertical_scale),
                None => options.scene.start_in(land),
            };
            (options.follows_world, options.pose) = (false, pose);
            view = options.view(0, streamer.cache());
            continue;
        }
        if streamer.is_settled() && selection.is_complete() {
            return Ok(());
        }
        let state = Progress {
            resident: streamer.cache().len(),
            missing: selection.missing,
            bytes_received: streamer.stream().traffic().bytes_received,
            link: streamer.link().clone(),
        };
        progress(&state);
        if let Some(detail) = streamer.refusal() {
            return Err(HeadlessError::Refused(detail.to_owned()));
        }
        match streamer.link() {
            Link::Connected(_) => lost = None,
            Link::Waiting { cause, .. } => lost = Some(cause.clone()),
            Link::Connecting | Link::GivenUp(_) => {}
        }
        match streamer.link() {
            Link::GivenUp(cause) => return Err(HeadlessError::Stream(cause.clone())),
            Link::Waiting { cause, .. }
                if streamer.failures() >= FIRST_ATTEMPTS && streamer.milestones().first_chunk.is_none() =>
            {
                return Err(HeadlessError::Stream(cause.clone()));
            }
            _ => {}
        }
        if started.elapsed() > options.timeout {
            let mut progress_text =
                format!("{} chunks resident, {} still coarse", state.resident, state.missing);
            if let Some(detail) = streamer.last_miss().filter(|_| streamer.missed() > 0) {
                progress_text += &format!(", {} bad or refused: {detail}", streamer.missed());
            }
            let seconds = options.timeout.as_secs();
            return Err(match lost {
                Some(cause) => HeadlessError::Lost { seconds, state: progress_text, cause },
                None => HeadlessError::Timeout { seconds, state: progress_text },
            });
        }
        // A settled view may still be incomplete, where the memory for chunks is too small for it.
        std::thread::sleep(POLL_PAUSE);
    }
}

impl Options {
    /// The view of a timed frame over the resident land.
    #[must_use]
    pub fn view(&self, frame: u32, cache: &ChunkCache) -> ViewParams {
        let mut pose = self.pose;
        if self.orbit_step_deg != 0.0 {
            let mut orbit = crate::camera::Orbit::through(&pose, self.scene.orbit_radius_m());
            orbit.bearing_deg += self.orbit_step_deg * f64::from(frame);
            pose = orbit.pose();
        }
        let eye = pose.eye();
        ViewParams {
            pose: pose.above(cache.ground(eye.units[0], eye.units[2])),
            projection: self.projection,
            view_distance_m: self.view_distance_m,
            tolerance_px: self.tolerance_px,
            time_s: self.time_s + frame as f32 / 60.0,
            settings: self.settings,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::{LocalStream, StreamEvent, Traffic};
    use std::collections::VecDeque;
    use terrain::{ChunkKey, Land, WorldDigest};

    /// A session that ends after one chunk if `ends`, and is idle otherwise.
    struct Short(VecDeque<StreamEvent>);

    impl Short {
        fn new(ends: bool) -> Self {
            let chunk = Box::new(Land::new(1).chunk(ChunkKey::new(3, 0, 0).unwrap()));
            let mut events = VecDeque::from([
                StreamEvent::Connected { world: WorldDigest([1; 32]), world_seed: 1, server: "test".into() },
                StreamEvent::Chunk(chunk),
            ]);
            if ends {
                let retry = Some(Duration::from_secs(9));
                events.push_back(StreamEvent::Disconnected { cause: "start it again".into(), retry });
            }
            Self(events)
        }
    }

    impl ChunkStream for Short {
        fn poll(&mut self) -> Option<StreamEvent> {
            self.0.pop_front()
        }
        fn set_view(&mut self, _: protocol::view::View) {}
        fn release(&mut self, _: &[ChunkKey]) {}
        fn holding(&mut self, _: &[ChunkKey]) {}
        fn delivery(&self) -> protocol::Delivery {
            protocol::Delivery::Exact
        }
        fn traffic(&self) -> Traffic {
            Traffic::default()
        }
    }

    #[test]
    fn an_incomplete_view_names_a_lost_server() {
        let stats = |ends| {
            let mut streamer = WorldStreamer::new(Short::new(ends), 10);
            let mut options = Options { timeout: Duration::from_millis(50), ..Options::default() };
            fill(&mut streamer, &mut options, Instant::now(), &mut |_| ()).unwrap_err().to_string()
        };
        let gone = stats(true);
        assert!(gone.contains("1 chunks resident") && gone.contains("gone: start it again"), "{gone}");
        let slow = stats(false);
        assert!(slow.contains("--timeout") && !slow.contains("gone"), "{slow}");
    }

    #[test]
    fn a_camera_may_start_where_the_announced_world_does() {
        let other = Scene::Island.start_in(&Land::new(2));
        for (follows_world, expected) in [(true, other), (false, Scene::Island.start())] {
            let mut options = Options { follows_world, view_distance_m: 100, ..Options::default() };
            let mut streamer = WorldStreamer::new(LocalStream::new(2), 1000);
            fill(&mut streamer, &mut options, Instant::now(), &mut |_| ()).unwrap();
            assert_eq!(options.pose, expected);
        }
    }
}
