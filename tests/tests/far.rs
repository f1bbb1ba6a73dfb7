//! Pictures are independent of the distance from the origin, pixel for pixel.
//!
//! Land differs between places, so the home island's chunks are translated: a source answers every
//! view from the land at the origin and shifts the keys by whole chunks of level 13 (2^20 m, a
//! multiple of every drawn chunk's side and of the period of all patterns). Camera, culling,
//! selection, patterns and the GPU get far coordinates only, and must draw the same picture.

use client::camera::{Pose, Projection};
use client::gpu::Image;
use client::headless::Options;
use client::settings::{Normals, RenderSettings};
use client::stream::{ChunkStream, LocalStream, StreamEvent, Traffic};
use glam::DVec3;
use protocol::Delivery;
use protocol::view::View;
use std::sync::LazyLock;
use terrain::ChunkKey;
use terrain::constants::{CHUNK_BITS, UNITS_PER_METRE};
use tests::places::{MOUNTAINS, SHORE, START};

/// Places are shifted by whole chunks of this level.
const SHIFT_LEVEL: u8 = 13;

/// Side of such a chunk, metres: 1,048,576.
const SHIFT_M: f64 = ((1i64 << (CHUNK_BITS + SHIFT_LEVEL as u32)) / UNITS_PER_METRE as i64) as f64;

/// The home island, translated by `x` chunks of level 13 east and `z` south.
struct Translated {
    home: LocalStream,
    x: i32,
    z: i32,
}

impl Translated {
    fn moved(&self, key: ChunkKey, sign: i32) -> ChunkKey {
        assert!(key.level() <= SHIFT_LEVEL, "{key} is larger than the shift");
        let chunks = sign << (SHIFT_LEVEL - key.level());
        ChunkKey::new(key.level(), key.x() + self.x * chunks, key.z() + self.z * chunks).unwrap()
    }

    fn home_keys(&self, keys: &[ChunkKey]) -> Vec<ChunkKey> {
        keys.iter().map(|key| self.moved(*key, -1)).collect()
    }
}

impl ChunkStream for Translated {
    fn poll(&mut self) -> Option<StreamEvent> {
        Some(match self.home.poll()? {
            StreamEvent::Chunk(mut chunk) => {
                chunk.key = self.moved(chunk.key, 1);
                StreamEvent::Chunk(chunk)
            }
            event => event,
        })
    }

    fn set_view(&mut self, view: View) {
        let [east, up, south] = view.eye;
        let back = 1 << (CHUNK_BITS + u32::from(SHIFT_LEVEL));
        self.home.set_view(View { eye: [east - self.x * back, up, south - self.z * back], ..view });
    }

    fn release(&mut self, keys: &[ChunkKey]) {
        let keys = self.home_keys(keys);
        self.home.release(&keys);
    }

    fn holding(&mut self, keys: &[ChunkKey]) {
        let keys = self.home_keys(keys);
        self.home.holding(&keys);
    }

    fn delivery(&self) -> Delivery {
        self.home.delivery()
    }

    fn traffic(&self) -> Traffic {
        self.home.traffic()
    }
}

/// Views of the home island: the start, a shore, and mountains from an eye between two units
/// (1/1024 m, held exactly by an f64 anywhere in the world).
static CAMERAS: LazyLock<[Pose; 3]> = LazyLock::new(|| {
    let pose = |camera: &str| on_metres(camera.parse().unwrap());
    let mut between = pose(&MOUNTAINS);
    between.position_m += DVec3::new(1.0, 0.0, -1.0) / 1024.0;
    [pose(&START), pose(&SHORE), between]
});

/// The pose at the nearest whole metres: a place that an f32 holds exactly anywhere in the world.
fn on_metres(pose: Pose) -> Pose {
    Pose { position_m: pose.position_m.round(), ..pose }
}

/// About 10^6 m east; north-west across both signs; near the far corner of the world.
const PLACES: [(i32, i32); 3] = [(1, 0), (-1, -1), (3, -3)];

fn pose(mut pose: Pose, (x, z): (i32, i32)) -> Pose {
    pose.position_m.x += f64::from(x) * SHIFT_M;
    pose.position_m.z += f64::from(z) * SHIFT_M;
    pose
}

/// Renders the translated island.
fn drawn(pose: Pose, (x, z): (i32, i32)) -> Option<Image> {
    // The clipmap would show the land of the seed, which differs between the places.
    let settings = RenderSettings { normals: Normals::Mesh, ..RenderSettings::default() };
    let options = Options { pose, settings, ..tests::options_at(&START, (256, 144)) };
    let (picture, stats) = tests::render_or_skip(Translated { home: LocalStream::new(1), x, z }, &options)?;
    assert!(stats.chunks_drawn > 6, "{stats:?}");
    Some(picture)
}

/// Pixels that are not the same in every byte.
fn differing(one: &Image, two: &Image) -> usize {
    assert_eq!((one.width, one.height), (two.width, two.height));
    one.rgba.chunks_exact(4).zip(two.rgba.chunks_exact(4)).filter(|(a, b)| a != b).count()
}

#[test]
fn a_scene_a_million_metres_from_the_origin_is_identical() {
    for (camera, place) in CAMERAS.iter().copied().zip(PLACES).chain([(CAMERAS[2], PLACES[0])]) {
        let Some(home) = drawn(pose(camera, (0, 0)), (0, 0)) else { return };
        let Some(far) = drawn(pose(camera, place), place) else { return };
        let count = differing(&home, &far);
        assert_eq!(count, 0, "{camera} at {place:?}: {count} pixels of {} differ", home.width * home.height);
    }
}

#[test]
fn small_offsets_and_f32_rounding_are_visible_far_out() {
    let (camera, place) = (CAMERAS[1], (2, 0));
    let Some(home) = drawn(pose(camera, (0, 0)), (0, 0)) else { return };
    let mut moved = pose(camera, place);
    moved.position_m.x += 0.25;
    let Some(moved) = drawn(moved, place) else { return };
    assert!(differing(&home, &moved) > 1_000, "{} pixels", differing(&home, &moved));

    // 1/16 m is half the resolution of f32 just below 2^21 m: the camera of an engine with absolute
    // floats.
    let shifted = |place| {
        let mut pose = pose(camera, place);
        pose.position_m.x += 0.0625;
        pose
    };
    let Some(home) = drawn(shifted((0, 0)), (0, 0)) else { return };
    let mut rounded = shifted(place);
    rounded.position_m.x = f64::from(rounded.position_m.x as f32);
    assert!(rounded != shifted(place), "an f32 does not hold this place");
    let Some(far) = drawn(rounded, place) else { return };
    assert!(differing(&home, &far) > 100, "{} pixels", differing(&home, &far));
}

/// The pixel position of a point whose clip position is `matrix * point` in f32.
fn pixels_f32(matrix: [[f32; 4]; 4], point: [f32; 3], projection: &Projection) -> [f64; 2] {
    let clip = [0, 1, 3].map(|row| {
        matrix[0][row] * point[0] + matrix[1][row] * point[1] + matrix[2][row] * point[2] + matrix[3][row]
    });
    let half = [f64::from(projection.width) / 2.0, f64::from(projection.height) / 2.0];
    [f64::from(clip[0] / clip[2]) * half[0], f64::from(clip[1] / clip[2]) * half[1]]
}

/// Without a GPU: the same points, 20 to 500 m away, through a camera-relative matrix and through
/// an absolute one.
#[test]
fn absolute_f32_transforms_err_by_pixels_relative_ones_do_not() {
    let projection = Projection { width: 1280, height: 720, fov_deg: 60.0 };
    let worst = |place| {
        let pose = pose(CAMERAS[2], place);
        let relative = projection.clip_from_camera(&pose).to_cols_array_2d();
        let eye = pose.position_m.to_array();
        // clip_from_world = clip_from_camera * translation by the negated eye, as an engine would
        // multiply it in f32.
        let mut absolute = relative;
        absolute[3] = [0, 1, 2, 3].map(|row| {
            let turned = |axis: usize| relative[axis][row] * -(eye[axis] as f32);
            turned(0) + turned(1) + turned(2) + relative[3][row]
        });
        let (ahead, right) = (pose.forward().to_array(), pose.right().to_array());
        let (mut of_relative, mut of_absolute) = (0.0f64, 0.0f64);
        for step in 1..=25 {
            for aside in -4..=4 {
                let (far, wide) = (f64::from(step) * 20.0, f64::from(step * aside) * 2.0);
                let offset = [0, 1, 2].map(|axis| ahead[axis] * far + right[axis] * wide);
                // In f64, by the camera's own axes: `wide` to the right at the distance `far`.
                let truth = wide / far / projection.half_height() * f64::from(projection.height) / 2.0;
                let from_eye = offset.map(|metres| metres as f32);
                let in_world = [0, 1, 2].map(|axis| (eye[axis] + offset[axis]) as f32);
                let miss = |got: [f64; 2]| (got[0] - truth).hypot(got[1]);
                of_relative = of_relative.max(miss(pixels_f32(relative, from_eye, &projection)));
                of_absolute = of_absolute.max(miss(pixels_f32(absolute, in_world, &projection)));
            }
        }
        (of_relative, of_absolute)
    };
    let (home, far) = (worst((0, 0)), worst((1, 0)));
    eprintln!("worst miss in pixels, relative and absolute: {home:?} at home, {far:?} a million metres away");
    assert!(home.0 < 0.01 && far.0 == home.0, "{home:?} {far:?}");
    assert!(far.1 > 1.0 && home.1 < 0.1, "{home:?} {far:?}");
}
