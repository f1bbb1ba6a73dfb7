//! Terrain shadows: against their definition, for extreme suns and land, and in pictures.

use client::cache::{ChunkCache, Resident};
use client::features::terrain_clipmap::window::STANDARD_TEXELS;
use client::frame::FrameData;
use client::gpu::{Gpu, Image, offscreen};
use client::headless::Options;
use client::lod::{Drawn, Selection, select};
use client::renderer::{RenderOptions, Renderer};
use client::scene::Scene;
use client::settings::{RenderSettings, Shadows, SunPosition};
use client::stream::LocalStream;
use client::view::ViewParams;
use shaders::layout::{clearance_of_byte, disc_share};
use shaders::twin::morph::Seams;
use std::collections::HashMap;
use terrain::constants::{CELLS, VERTEX_COUNT, VERTICES};
use terrain::{Chunk, ChunkKey, GrassSeed, Land, Pyramid, lod};
use tests::horizon;
use tests::places::{MOUNTAINS, START};

const SLOTS: u32 = 1000;

fn renderer(gpu: &Gpu) -> Renderer {
    let options = RenderOptions {
        scene: Scene::Island,
        size: (64, 36),
        samples: 1,
        anisotropy: 1,
        format: offscreen::IMAGE_FORMAT,
        slots: SLOTS,
        clipmap_texels: STANDARD_TEXELS,
    };
    Renderer::new(gpu, &options)
}

fn view(camera: &str, sun: (f32, f32)) -> ViewParams {
    let sun = SunPosition { azimuth_deg: sun.0, elevation_deg: sun.1 };
    let view = tests::view_at(camera, (640, 360), 4000, 3.0);
    ViewParams { settings: RenderSettings { sun: Some(sun), ..view.settings }, ..view }
}

/// A drawn world, and the clearances that the GPU computes for its visible chunks.
struct Scenery {
    world: ChunkCache,
    selection: Selection,
    gpu: Gpu,
    renderer: Renderer,
}

impl Scenery {
    fn of(view: &ViewParams) -> Option<Self> {
        let (gpu, land) = (tests::open_gpu_or_skip()?, Land::new(1));
        let mut world = ChunkCache::new(SLOTS);
        for needed in lod::select(&land, &view.viewer(), usize::MAX) {
            assert!(
                world.insert(land.chunk(needed.key)).evicted.is_empty(),
                "the pool is too small for the test"
            );
        }
        let selection = select(&mut world, &view.viewer());
        Some(Self::with(gpu, world, selection))
    }

    fn with(gpu: Gpu, world: ChunkCache, selection: Selection) -> Self {
        let mut renderer = renderer(&gpu);
        for key in world.keys() {
            renderer.upload(&gpu, world.get(key).unwrap());
        }
        Self { world, selection, gpu, renderer }
    }

    fn frame(&self, view: &ViewParams) -> FrameData {
        view.frame(Scene::Island, &self.world, &self.selection)
    }

    /// Clearances as bytes, of every visible chunk.
    fn cast(&mut self, view: &ViewParams) -> HashMap<ChunkKey, Vec<u8>> {
        let frame = self.frame(view);
        self.renderer.finish_shading(&self.gpu, &frame).unwrap();
        let seen = frame.candidates.iter().filter(|candidate| candidate.is_visible);
        seen.map(|seen| {
            let bytes = self.renderer.pool().read_sun_clearances(&self.gpu, seen.page.slot).unwrap();
            assert_eq!(bytes.len(), VERTEX_COUNT);
            assert!(!bytes.contains(&0), "no clearance is written as 0");
            (seen.page.key, bytes)
        })
        .collect()
    }

    fn chunks(&self) -> Vec<(ChunkKey, &Resident)> {
        self.selection.drawn.iter().map(|drawn| (drawn.key, self.world.get(drawn.key).unwrap())).collect()
    }
}

fn place(key: ChunkKey, index: usize) -> (i64, i64) {
    let (x, z) = key.origin();
    let at = |low: i32, n: usize| i64::from(low) + n as i64 * i64::from(key.spacing());
    (at(x, index % VERTICES), at(z, index / VERTICES))
}

/// The share of sampled vertices whose visible part of the sun deviates by more than a tolerance,
/// and the share of those in the penumbra by definition.
///
/// Tolerance: a byte holds a clearance near the rim to 1/45 of a radius, the share changes by 2/pi
/// per radius, and corners of cells that are cut by less than 16 mm may be missed.
fn disagreement(
    truth: &horizon::Drawn<'_>,
    cast: &HashMap<ChunkKey, Vec<u8>>,
    sun: (f32, f32),
    stride: usize,
) -> (f64, f64) {
    let (azimuth, elevation) = (f64::from(sun.0).to_radians(), f64::from(sun.1).to_radians());
    let (mut off, mut partial, mut all) = (0u32, 0u32, 0u32);
    let mut keys: Vec<_> = cast.keys().copied().collect();
    keys.sort_unstable();
    for (nth, key) in keys.into_iter().enumerate() {
        for index in (nth * 97 % stride..VERTEX_COUNT).step_by(stride) {
            let clearance = truth.clearance(place(key, index), azimuth, elevation);
            let expected = disc_share(clearance);
            let got = disc_share(clearance_of_byte(cast[&key][index]));
            off += u32::from((expected - got).abs() > 0.03);
            partial += u32::from(clearance.abs() < 1.0);
            all += 1;
        }
    }
    assert!(all > 120, "{all} vertices");
    (f64::from(off) / f64::from(all), f64::from(partial) / f64::from(all))
}

/// Suns from all sides, two of them along an axis and along the diagonals of the cells.
const SUNS: [(f32, f32); 6] =
    [(130.0, 3.0), (290.0, 8.0), (90.0, 8.0), (315.0, 8.0), (33.0, 20.0), (127.1, 43.0)];

#[test]
fn shadows_agree_with_their_definition() {
    let shot_at = |sun| view(&MOUNTAINS, sun);
    let Some(mut scenery) = Scenery::of(&shot_at(SUNS[0])) else { return };
    for sun in SUNS {
        let cast = scenery.cast(&shot_at(sun));
        let truth = horizon::Drawn { chunks: scenery.chunks() };
        let (off, partial) = disagreement(&truth, &cast, sun, 599);
        eprintln!("sun {sun:?}: {:.2} % off, {:.1} % in the penumbra", 100.0 * off, 100.0 * partial);
        assert!(off <= 0.005, "sun {sun:?}: {off}");
        if sun.1 > 10.0 {
            continue;
        }
        let mirrored = disagreement(&truth, &cast, (sun.0 + 180.0, sun.1), 599).0;
        assert!(mirrored > 0.1, "a sun on the other side: {mirrored}");
    }

    let sun = SUNS[1];
    let cast = scenery.cast(&shot_at(sun));
    let mut moved: Vec<(ChunkKey, Resident)> =
        scenery.chunks().into_iter().map(|(key, chunk)| (key, chunk.clone())).collect();
    for (_, chunk) in &mut moved {
        chunk.heights.rotate_left(1);
    }
    let moved = horizon::Drawn { chunks: moved.iter().map(|(key, chunk)| (*key, chunk)).collect() };
    let shifted = disagreement(&moved, &cast, sun, 599).0;
    assert!(shifted > 0.03, "land that lies one vertex farther: {shifted}");

    let chunks: Vec<Resident> = scenery.chunks().into_iter().map(|(_, chunk)| chunk.clone()).collect();
    for chunk in chunks {
        let mut lowered = chunk.clone();
        let minima = Pyramid::of_minima(&chunk.heights);
        let texels: Vec<i32> = (3..7).flat_map(|level| minima.level(level).to_vec()).collect();
        lowered.maxima = texels.try_into().unwrap();
        scenery.renderer.upload(&scenery.gpu, &lowered);
    }
    let cast = scenery.cast(&shot_at(sun));
    let truth = horizon::Drawn { chunks: scenery.chunks() };
    let skipped = disagreement(&truth, &cast, sun, 599).0;
    assert!(skipped > 0.03, "blocks skipped by their minima: {skipped}");
}

/// The bytes of both chunks at the vertices that two drawn chunks share.
fn shared(cast: &HashMap<ChunkKey, Vec<u8>>) -> Vec<(bool, u8, u8)> {
    let mut at: HashMap<(i64, i64), (u8, u8)> = HashMap::new();
    let mut shared = Vec::new();
    let mut keys: Vec<_> = cast.keys().copied().collect();
    keys.sort_unstable();
    for key in keys {
        for (index, byte) in cast[&key].iter().copied().enumerate() {
            let (column, row) = (index % VERTICES, index / VERTICES);
            if !(column % CELLS == 0 || row % CELLS == 0) {
                continue;
            }
            if let Some((level, other)) = at.insert(place(key, index), (key.level(), byte)) {
                shared.push((level == key.level(), other, byte));
            }
        }
    }
    shared
}

#[test]
fn adjacent_chunks_agree_about_the_sun_on_their_border() {
    let sun = (290.0, 8.0);
    let view = view(&MOUNTAINS, sun);
    let Some(mut scenery) = Scenery::of(&view) else { return };
    let shared = shared(&scenery.cast(&view));
    let count = |equal: bool| shared.iter().filter(|(level, ..)| *level == equal).count();
    assert!(count(true) > 1000 && count(false) > 500, "{} {}", count(true), count(false));
    let apart = shared.iter().filter(|(_, one, two)| one.abs_diff(*two) > 2).count();
    let varied = shared.iter().filter(|(_, one, _)| (2..255).contains(one)).count();
    assert!(varied > 200, "borders cross edges of shadows: {varied}");
    assert!(apart * 500 <= shared.len(), "{apart} of {} shared vertices differ", shared.len());
}

/// A row of level-0 chunks 10 m above the sea, one vertex of the first one `spike_m` high.
fn plain(gpu: Gpu, spike_m: i32, from_x: i32, z: i32) -> Scenery {
    let mut world = ChunkCache::new(SLOTS);
    let mut drawn = Vec::new();
    for x in 0..16 {
        let key = ChunkKey::new(0, from_x + x, z).unwrap();
        let mut heights = Box::new([10 * 256; VERTEX_COUNT]);
        if x == 0 {
            heights[32 * VERTICES + 32] = spike_m * 256;
        }
        let grass = GrassSeed::grow(1, key, &heights);
        world.insert(Chunk::from_parts(key, heights, 0, grass));
        drawn.push(Drawn { key, seams: Seams::default() });
    }
    Scenery::with(gpu, world, Selection { drawn, missing: 0 })
}

/// From high above: every chunk is visible.
const ABOVE: &str = "1024,9000,64,0,-90";

#[test]
fn a_spike_of_4_km_casts_a_shadow_of_the_right_length() {
    let Some(gpu) = tests::open_gpu_or_skip() else { return };
    let mut plain = plain(gpu, 4000, 0, 0);
    let sun = (270.0, 70.0);
    let cast = plain.cast(&view(ABOVE, sun));
    assert_eq!(cast.len(), 16);
    // Row 32 lies behind the spike; 3990 m / tan(70 degrees) = 1452 m from x = 64.
    for metres in (80..2000).step_by(8) {
        let key = ChunkKey::new(0, metres / 128, 0).unwrap();
        let at = |row: usize| clearance_of_byte(cast[&key][row * VERTICES + (metres as usize % 128) / 2]);
        assert!((at(32) < 0.0) == (metres - 64 < 1452), "{metres} m: {}", at(32));
        // The disc is 0.53 degrees wide, its penumbra 42 m long.
        assert!(at(32).abs() > 1.0 || (1430..=1475).contains(&(metres - 64)), "{metres} m: {}", at(32));
        assert!(at(20) > 7.9, "24 m beside it there is none");
    }
    let truth = horizon::Drawn { chunks: plain.chunks() };
    assert!(disagreement(&truth, &cast, sun, 167).0 <= 0.005);
}

#[test]
fn every_sun_yields_a_defined_shadow_at_the_corner_of_the_world() {
    let Some(gpu) = tests::open_gpu_or_skip() else { return };
    let last = 32_767;
    let mut plain = plain(gpu, 4000, last - 15, last);
    for elevation in [-90.0, -8.0, -0.3, -0.2, 0.0, 0.01, 0.3, 45.0, 89.0, 89.9, 90.0] {
        for azimuth in [0.0, 45.0, 270.0, 359.9] {
            let camera = format!("{},9000,{},0,-90", (last - 7) * 128, last * 128 + 64);
            let cast = plain.cast(&view(&camera, (azimuth, elevation)));
            assert_eq!(cast.len(), 16);
            let all = cast.values().flatten();
            let (dark, lit) = all.fold((0, 0), |(dark, lit), byte| {
                let share = disc_share(clearance_of_byte(*byte));
                (dark + u32::from(share == 0.0), lit + u32::from(share == 1.0))
            });
            let count = 16 * VERTEX_COUNT as u32;
            match elevation {
                -90.0..-0.27 => assert_eq!((dark, lit), (count, 0), "the sun is down at {elevation}"),
                89.8.. => assert_eq!((dark, lit), (0, count), "the zenith, {elevation}"),
                0.3..45.1 => assert!(lit > count / 2 && dark > 0, "{elevation}: {lit} lit, {dark} dark"),
                _ => {}
            }
        }
    }
}

fn drawn(camera: &str, sun: Option<(f32, f32)>, shadows: Shadows) -> Option<Image> {
    let sun = sun.map(|(azimuth_deg, elevation_deg)| SunPosition { azimuth_deg, elevation_deg });
    let options = tests::options_at(camera, (256, 144));
    let settings = RenderSettings { sun, shadows, ..options.settings };
    let rendered = tests::render_or_skip(LocalStream::new(1), &Options { settings, ..options });
    rendered.map(|(picture, _)| picture)
}

/// Mean of all channels of the lower half, where the land is.
fn brightness(picture: &Image) -> f64 {
    let half = &picture.rgba[picture.rgba.len() / 2..];
    let sum: u64 = half.chunks_exact(4).map(|p| p[..3].iter().map(|c| u64::from(*c)).sum::<u64>()).sum();
    sum as f64 / (half.len() / 4 * 3) as f64
}

#[test]
fn low_suns_darken_the_far_side_of_hills() {
    // Towards the sun, where the shadow sides are visible, and away from it: from the sea, so that
    // no land behind the eye casts a shadow on what it sees.
    let inland = Scene::Island.start().yaw_deg as f32;
    let darker = |azimuth| {
        let lit = drawn(&START, Some((azimuth, 8.0)), Shadows::Off)?;
        let shaded = drawn(&START, Some((azimuth, 8.0)), Shadows::Soft)?;
        Some(1.0 - brightness(&shaded) / brightness(&lit))
    };
    let (Some(into), Some(behind)) = (darker(inland), darker(inland + 180.0)) else { return };
    eprintln!("darker by {:.1} % into the sun, {:.1} % with the sun behind", 100.0 * into, 100.0 * behind);
    assert!(into > 0.04 && into > 2.0 * behind.max(0.0), "{into} {behind}");
}

#[test]
fn shadow_kinds_differ_at_low_suns_and_not_at_the_zenith() {
    let Some(off) = drawn(&MOUNTAINS, Some((0.0, 90.0)), Shadows::Off) else { return };
    let Some(soft) = drawn(&MOUNTAINS, Some((0.0, 90.0)), Shadows::Soft) else { return };
    assert!(off.rgba == soft.rgba, "no land occludes the zenith");
    let evening = |shadows| drawn(&MOUNTAINS, Some((130.0, 8.0)), shadows).unwrap().rgba;
    let (off, hard, soft) = (evening(Shadows::Off), evening(Shadows::Hard), evening(Shadows::Soft));
    assert!(off != soft && hard != soft && off != hard);
    assert!(soft == evening(Shadows::Soft), "twice the same");
}
