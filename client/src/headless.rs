//! Pictures without a window: fill the view from a feed, draw it, time it, read it back. Local
//! scenes need no feed.

use crate::camera::{Lens, Pose};
use crate::feed::{Feed, NoFeed};
use crate::frame::{Shot, TRIANGLES_PER_INSTANCE};
use crate::looks::Looks;
use crate::render::cast::PER_FRAME;
use crate::render::materials::OwnMaterials;
use crate::render::pool::ChunkPool;
use crate::render::{Canvas, Gpu, GpuError, Picture, RenderOptions, Renderer, gpu, picture};
use crate::scene::Scene;
use crate::shadow::Quota;
use crate::stats::{FrameTimes, Stats};
use crate::voyage::{Link, Voyage};
use crate::world::World;
use crate::world::resident::SLOT_BYTES;
use std::time::{Duration, Instant};

/// Pictures that are drawn before the clock counts: pipelines compile and caches fill.
const WARM_UP_FRAMES: u32 = 3;

/// A first connection that fails so often will not succeed by waiting: there is no server.
const FIRST_ATTEMPTS: u32 = 3;

/// Pause between looks at the feed while the view fills.
const POLL_PAUSE: Duration = Duration::from_millis(2);

/// A camera that never turns needs no shadows out of sight.
const IN_SIGHT_PER_FRAME: Quota = Quota { ahead: 0, ..PER_FRAME };

/// What to render.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// The scene.
    pub scene: Scene,
    /// Eye and gaze.
    pub pose: Pose,
    /// Field of view and picture size.
    pub lens: Lens,
    /// View distance, metres.
    pub view_distance_m: u32,
    /// Tolerated screen error, pixels.
    pub tolerance_px: f64,
    /// Memory for chunks, bytes, CPU and GPU together.
    pub chunk_bytes: usize,
    /// Samples per pixel, 1 or 4.
    pub samples: u32,
    /// Frames to time, at least 1.
    pub frames: u32,
    /// Degrees that the camera circles between two frames; 0 stands still.
    pub orbit_step_deg: f64,
    /// Seconds of the moving parts in the first frame; every further frame adds 1/60.
    pub time_s: f32,
    /// Knobs of the picture.
    pub looks: Looks,
    /// How much higher the land is drawn than it is, 0.25 to 4.
    pub vertical_scale: f64,
    /// Materials instead of the procedural ones.
    pub materials: OwnMaterials,
    /// How long the view may take to fill.
    pub timeout: Duration,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            scene: Scene::Island,
            pose: Scene::Island.start(),
            lens: Lens { fov_deg: 60.0, width: 1280, height: 720 },
            view_distance_m: 8000,
            tolerance_px: 2.0,
            chunk_bytes: 128 << 20,
            samples: 4,
            frames: 1,
            orbit_step_deg: 0.0,
            time_s: 0.0,
            looks: Looks::default(),
            vertical_scale: 1.0,
            materials: OwnMaterials::default(),
            timeout: Duration::from_secs(60),
        }
    }
}

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
pub enum HeadlessError {
    /// The GPU.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// No session came about, or it ended for good.
    #[error("{0}")]
    Feed(String),
    /// The server does not serve this view.
    #[error("the server refused the view: {0}")]
    Refused(String),
    /// The view did not fill.
    #[error("the view was not complete after {seconds} s ({state}): allow more time with --timeout")]
    Timeout {
        /// The limit.
        seconds: u64,
        /// How far it got.
        state: String,
    },
    /// The view did not fill, and there is no session any more.
    #[error("the view was not complete after {seconds} s ({state}), and the server is gone: {cause}")]
    Lost {
        /// The limit.
        seconds: u64,
        /// How far it got.
        state: String,
        /// What ended the session, with a mend.
        cause: String,
    },
}

/// How far the filling is, for a progress display.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// Chunks in memory.
    pub resident: usize,
    /// Chunks drawn coarser than wanted.
    pub wanting: usize,
    /// Bytes received.
    pub bytes_received: u64,
    /// The session's state.
    pub link: Link,
}

/// Renders a local scene: no feed, no chunks. `started` is when the clock of the stats began.
///
/// # Errors
/// There is no GPU, or it fails. A scene that is not local is drawn without land.
pub fn render_local(options: &Options, started: Instant) -> Result<(Picture, Stats), HeadlessError> {
    draw(options, NoFeed, started, |_| Ok(()))
}

/// Fills the view and renders it. `started` is when the clock of the stats began.
pub fn render(
    options: &Options,
    feed: impl Feed,
    started: Instant,
    mut progress: impl FnMut(&Progress),
) -> Result<(Picture, Stats), HeadlessError> {
    if options.scene.is_local() {
        return render_local(options, started);
    }
    draw(options, feed, started, |voyage| {
        fill(voyage, options, started, &mut progress)?;
        // How high the ground is under the eye is known now; an eye that has to be lifted sees
        // other chunks.
        fill(voyage, options, started, &mut progress)
    })
}

/// Lets `fill` bring what is to be drawn, builds the renderer, draws, times and reads back. In this
/// order: a view that cannot be had is told without waiting for materials and pipelines.
fn draw<F: Feed>(
    options: &Options,
    feed: F,
    started: Instant,
    fill: impl FnOnce(&mut Voyage<F>) -> Result<(), HeadlessError>,
) -> Result<(Picture, Stats), HeadlessError> {
    let gpu = pollster::block_on(Gpu::open(gpu::instance(None), None))?;
    let wished = if options.scene.is_local() { 1 } else { World::capacity_for(options.chunk_bytes) };
    let slots = ChunkPool::slots_within(&gpu.device.limits(), wished);
    let size = (options.lens.width, options.lens.height);
    let mut voyage = Voyage::new(feed, slots).stretched(options.vertical_scale);
    fill(&mut voyage)?;
    let mut renderer = Renderer::with_materials(
        &gpu,
        &RenderOptions {
            scene: options.scene,
            size,
            samples: options.samples,
            format: picture::PICTURE_FORMAT,
            slots,
        },
        &options.materials,
    );
    let canvas = Canvas::new(&gpu.device, size.0, size.1);
    voyage.world().residents().for_each(|chunk| renderer.upload(&gpu, chunk));

    let mut times = FrameTimes::default();
    let (mut drawn, mut instances) = (0, 0);
    let mut camera = String::new();
    let mut first_picture = None;
    for index in 0..WARM_UP_FRAMES + options.frames.max(1) {
        let timed = index.checked_sub(WARM_UP_FRAMES);
        let begun = Instant::now();
        let shot = options.shot(timed.unwrap_or(0), voyage.world());
        let selection =
            voyage.update(&shot, started.elapsed(), usize::MAX, |chunk| renderer.upload(&gpu, chunk));
        let frame = shot.frame(options.scene, voyage.world(), &selection);
        (drawn, instances) = (frame.chunks, frame.instances.len());
        camera = format!("{:.4}", shot.pose);
        if timed.is_none() {
            // What a camera that stands still has seen long ago. Shadows that change while frames
            // are timed are part of them.
            renderer.finish_shadows(&gpu, &frame)?;
        }
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let pending = renderer.cast(&gpu, &frame, IN_SIGHT_PER_FRAME, &mut encoder);
        renderer.draw(&gpu, &frame, &mut encoder, &canvas.view);
        gpu.queue.submit([encoder.finish()]);
        gpu.wait()?;
        first_picture.get_or_insert_with(|| started.elapsed());
        if timed.is_some() {
            times.push(begun.elapsed());
        }
        if pending > 0 && index + 1 == WARM_UP_FRAMES + options.frames.max(1) {
            // The picture that is kept shows the finished state, whatever the time for it was.
            renderer.finish_shadows(&gpu, &frame)?;
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            renderer.draw(&gpu, &frame, &mut encoder, &canvas.view);
            gpu.queue.submit([encoder.finish()]);
            gpu.wait()?;
        }
    }
    let picture = canvas.read(&gpu)?;
    let told = renderer.garden().map(|garden| garden.told(&gpu)).transpose()?.unwrap_or_default();
    let milestones = voyage.milestones();
    let resident = voyage.world().len();
    let stats = Stats {
        adapter: gpu.name(),
        frames: options.frames.max(1) as usize,
        chunks_drawn: drawn,
        triangles: instances as u64 * TRIANGLES_PER_INSTANCE,
        terrain_draws: renderer.terrain_draws(),
        plants_drawn: told.clumps,
        plants_lost: told.clumps_lost,
        gpu_bytes_per_chunk: renderer.bytes_per_chunk(),
        delivery: if options.scene.is_local() { "none" } else { voyage.feed().delivery().name() },
        bytes_received: voyage.feed().traffic().bytes_received,
        seconds_to_first_chunk: milestones.first_chunk.map(|at| at.as_secs_f64()),
        seconds_to_complete_view: milestones.complete_view.map(|at| at.as_secs_f64()),
        seconds_to_first_picture: first_picture.map(|at| at.as_secs_f64()),
        frame_ms_p50: times.quantile_ms(0.5, usize::MAX),
        frame_ms_p99: times.quantile_ms(0.99, usize::MAX),
        chunks_resident: resident,
        chunk_bytes_resident: resident * SLOT_BYTES,
        chunk_bytes_budget: slots as usize * SLOT_BYTES,
        tolerance_px: voyage.tolerance_px(&options.shot(0, voyage.world())),
        camera,
    };
    Ok((picture, stats))
}

/// Runs the feed until the view is complete.
fn fill(
    voyage: &mut Voyage<impl Feed>,
    options: &Options,
    started: Instant,
    progress: &mut impl FnMut(&Progress),
) -> Result<(), HeadlessError> {
    let shot = options.shot(0, voyage.world());
    let mut lost = None;
    loop {
        // There is no renderer yet: it is given everything at once when it is built.
        let selection = voyage.update(&shot, started.elapsed(), 64, |_| ());
        if voyage.is_settled() && selection.is_complete() {
            return Ok(());
        }
        let state = Progress {
            resident: voyage.world().len(),
            wanting: selection.wanting,
            bytes_received: voyage.feed().traffic().bytes_received,
            link: voyage.link().clone(),
        };
        progress(&state);
        if let Some(detail) = voyage.refusal() {
            return Err(HeadlessError::Refused(detail.to_owned()));
        }
        match voyage.link() {
            Link::Connected(_) => lost = None,
            Link::Waiting { cause, .. } => lost = Some(cause.clone()),
            Link::Connecting | Link::Refused(_) => {}
        }
        match voyage.link() {
            Link::Refused(cause) => return Err(HeadlessError::Feed(cause.clone())),
            Link::Waiting { cause, .. }
                if voyage.failures() >= FIRST_ATTEMPTS && voyage.milestones().first_chunk.is_none() =>
            {
                return Err(HeadlessError::Feed(cause.clone()));
            }
            _ => {}
        }
        if started.elapsed() > options.timeout {
            let had = format!("{} chunks here, {} places still coarse", state.resident, state.wanting);
            let seconds = options.timeout.as_secs();
            return Err(match lost {
                Some(cause) => HeadlessError::Lost { seconds, state: had, cause },
                None => HeadlessError::Timeout { seconds, state: had },
            });
        }
        if !voyage.is_settled() {
            std::thread::sleep(POLL_PAUSE);
        }
    }
}

impl Options {
    /// The shot of a timed frame over the land that is here.
    #[must_use]
    pub fn shot(&self, frame: u32, world: &World) -> Shot {
        let mut pose = self.pose;
        if self.orbit_step_deg != 0.0 {
            let mut orbit = crate::camera::Orbit::through(&pose, self.scene.orbit_radius_m());
            orbit.bearing_deg += self.orbit_step_deg * f64::from(frame);
            pose = Pose { pitch_deg: pose.pitch_deg, ..orbit.pose() };
        }
        let eye = pose.eye();
        Shot {
            pose: pose.above(world.ground(eye.units[0], eye.units[2])),
            lens: self.lens,
            view_distance_m: self.view_distance_m,
            tolerance_px: self.tolerance_px,
            time_s: self.time_s + frame as f32 / 60.0,
            looks: self.looks,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feed::{FeedEvent, Traffic};
    use std::collections::VecDeque;
    use terrain::{ChunkKey, Land, WorldDigest};

    /// A session that ends after one chunk, if `ends`, and else says nothing more.
    struct Short(VecDeque<FeedEvent>);

    impl Short {
        fn new(ends: bool) -> Self {
            let chunk = Box::new(Land::new(1).chunk(ChunkKey::new(3, 0, 0).unwrap()));
            let mut events = VecDeque::from([
                FeedEvent::Connected { world: WorldDigest([1; 32]), world_seed: 1, server: "test".into() },
                FeedEvent::Chunk(chunk),
            ]);
            if ends {
                let retry = Some(Duration::from_secs(9));
                events.push_back(FeedEvent::Disconnected { cause: "start it again".into(), retry });
            }
            Self(events)
        }
    }

    impl Feed for Short {
        fn poll(&mut self) -> Option<FeedEvent> {
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
    fn a_view_that_does_not_fill_names_a_server_that_is_gone() {
        let told = |ends| {
            let mut voyage = Voyage::new(Short::new(ends), 10);
            let options = Options { timeout: Duration::from_millis(50), ..Options::default() };
            fill(&mut voyage, &options, Instant::now(), &mut |_| ()).unwrap_err().to_string()
        };
        let gone = told(true);
        assert!(gone.contains("1 chunks here") && gone.contains("gone: start it again"), "{gone}");
        let slow = told(false);
        assert!(slow.contains("--timeout") && !slow.contains("gone"), "{slow}");
    }
}
