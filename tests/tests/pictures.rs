//! The headless viewer against golden pictures, and controls that must fail.

use client::features::vegetation::VegetationSettings;
use client::gpu::Image;
use client::headless::{self, Options};
use client::native::stream::{ServerStream, Settings};
use client::scene::Scene;
use client::settings::{Normals, Shadows, SunPosition};
use client::stats::Stats;
use client::stream::LocalStream;
use std::time::Instant;
use terrain::constants::{VERTEX_COUNT, VERTICES};
use terrain::{ChunkKey, Land, Octaves, Position};
use tests::RunningServer;
use tests::deformed_source::{Deformation, DeformedSource};
use tests::golden::{self, Difference, FINE_TOLERANCE, TOLERANCE};
use tests::places::{ABOVE, BEACH, MEADOW, MOUNTAINS, SHORE, START};
use tests::rendering::rendered_or_skip;

const WORLD_SEED: u64 = 1;

fn options(camera: &str) -> Options {
    tests::options_at(camera, (256, 144))
}

/// As [`options`], as far as detail near the eye needs.
fn near(camera: &str) -> Options {
    Options { view_distance_m: 3000, ..options(camera) }
}

fn with_sun(mut options: Options, azimuth_deg: f32, elevation_deg: f32) -> Options {
    options.settings.sun = Some(SunPosition { azimuth_deg, elevation_deg });
    options
}

/// Shadows at a low sun.
fn evening() -> Options {
    with_sun(near(&MOUNTAINS), 20.0, 8.0)
}

/// Grass and trees.
fn plants() -> Options {
    let mut options = near(&MEADOW);
    options.settings.plants = VegetationSettings::STANDARD;
    options
}

/// A beach and waves.
fn sea() -> Options {
    near(&BEACH)
}

/// The same where light follows the drawn triangles: materials and other light follow the land of
/// the seed, which the source of the chunks cannot change.
fn shaded_mesh() -> Options {
    let mut options = sea();
    options.settings.normals = Normals::Mesh;
    options
}

/// A scene without land.
fn landless(scene: Scene) -> Options {
    Options { scene, pose: scene.start(), ..options(&START) }
}

/// Renders land that is generated locally, or a scene without land.
fn render_or_skip(options: &Options) -> Option<(Image, Stats)> {
    if options.scene.is_local() {
        return rendered_or_skip(headless::render_local(options, Instant::now()));
    }
    tests::render_or_skip(LocalStream::new(WORLD_SEED), options)
}

/// Compares a view with its golden picture.
fn check(name: &str, options: &Options) {
    if let Some((picture, _)) = render_or_skip(options) {
        golden::check(name, &picture).unwrap();
    }
}

#[test]
fn the_island_equals_its_golden_pictures() {
    assert_eq!(options(&START).pose, Scene::Island.start());
    check("start", &options(&START));
    check("shore", &options(&SHORE));
    check("summit", &options(&MOUNTAINS));
    check("below", &options(&ABOVE));
}

#[test]
fn shadows_plants_sea_and_night_equal_their_golden_pictures() {
    check("evening", &evening());
    if let Some((picture, _)) = render_or_skip(&plants()) {
        golden::check_within("plants", &picture, FINE_TOLERANCE).unwrap();
    }
    check("sea", &sea());
    check("mesh", &shaded_mesh());
    check("night", &with_sun(near(&START), 250.0, -6.0));
}

#[test]
fn scenes_without_land_equal_their_golden_pictures() {
    check("relief", &landless(Scene::Brick));
    check("silhouettes", &landless(Scene::Spom));
    check("bay", &landless(Scene::Water));
}

/// Fails if a picture that is not the golden one is within its tolerance.
fn must_differ(name: &str, what: &str, picture: &Image) {
    must_differ_by(TOLERANCE, name, what, picture);
}

fn must_differ_by(tolerance: Difference, name: &str, what: &str, picture: &Image) {
    let difference = Difference::between(&golden::golden(name).unwrap(), picture);
    golden::require_rejected(&format!("{name}, {what}"), difference, tolerance);
}

#[test]
fn blank_shifted_and_other_pictures_fail_the_comparison() {
    if golden::is_blessing() {
        return;
    }
    let picture = golden::golden("start").unwrap();
    let blank = Image { rgba: vec![0; picture.rgba.len()], ..picture.clone() };
    let mut shifted = picture.clone();
    shifted.rgba.rotate_right(4);
    let sky = Image { rgba: picture.rgba[..4].repeat(picture.rgba.len() / 4), ..picture.clone() };
    for (what, other) in [("blank", blank), ("shifted by a pixel", shifted), ("sky only", sky)] {
        must_differ("start", what, &other);
    }
    assert!(Difference::between(&picture, &picture).is_tolerable());
}

#[test]
fn near_misses_of_the_light_fail_the_comparison() {
    if golden::is_blessing() {
        return;
    }
    let mut unshaded = evening();
    unshaded.settings.shadows = Shadows::Off;
    let Some((unshaded, _)) = render_or_skip(&unshaded) else { return };
    must_differ("evening", "without shadows", &unshaded);
    let sun = Scene::Island.light().sun;
    let azimuth_deg = sun.x.atan2(-sun.z).to_degrees();
    let moved = with_sun(options(&START), azimuth_deg + 5.0, sun.y.asin().to_degrees());
    must_differ("start", "the sun moved by 5 degrees", &render_or_skip(&moved).unwrap().0);
}

#[test]
fn near_misses_of_the_land_fail_the_comparison() {
    if golden::is_blessing() {
        return;
    }
    let deformed = |options: &Options, deformation: Deformation| {
        tests::render_or_skip(DeformedSource::new(WORLD_SEED, deformation), options)
    };
    let Some((coarser, _)) = deformed(&options(&MOUNTAINS), without_odd_vertices) else { return };
    must_differ("summit", "one level coarser", &coarser);
    let (smoother, _) = deformed(&shaded_mesh(), without_the_last_octave).unwrap();
    must_differ("mesh", "one octave less", &smoother);
}

#[test]
fn a_picture_without_one_of_its_trees_fails_the_comparison() {
    if golden::is_blessing() {
        return;
    }
    let mut treeless = plants();
    treeless.settings.plants.trees = 0;
    let Some((treeless, _)) = render_or_skip(&treeless) else { return };
    let golden = golden::golden("plants").unwrap();
    let tree = smallest_component(&golden, &treeless, 80).expect("trees stand in the picture");
    let mut one_less = golden;
    for at in &tree {
        one_less.rgba[at * 4..][..4].copy_from_slice(&treeless.rgba[at * 4..][..4]);
    }
    let what = format!("without a tree of {} pixels", tree.len());
    must_differ_by(FINE_TOLERANCE, "plants", &what, &one_less);
}

/// Heights with the detail of the next coarser level: odd vertices are the middle of even ones.
fn without_odd_vertices(_: ChunkKey, heights: &mut [i32; VERTEX_COUNT], error: u32) -> u32 {
    let fine = *heights;
    let at = |x: usize, z: usize| fine[z * VERTICES + x];
    for z in 0..VERTICES {
        for x in 0..VERTICES {
            // Cells are cut from their low to their high corner.
            heights[z * VERTICES + x] = match (x % 2, z % 2) {
                (0, 0) => at(x, z),
                (1, 0) => i32::midpoint(at(x - 1, z), at(x + 1, z)),
                (0, 1) => i32::midpoint(at(x, z - 1), at(x, z + 1)),
                _ => i32::midpoint(at(x - 1, z - 1), at(x + 1, z + 1)),
            };
        }
    }
    error
}

/// Heights of the levels with all octaves, without the last of them.
fn without_the_last_octave(key: ChunkKey, heights: &mut [i32; VERTEX_COUNT], error: u32) -> u32 {
    if key.level() > 2 {
        return error;
    }
    let (land, octaves) = (Land::new(WORLD_SEED), Octaves::new(Octaves::ALL.count() - 1).unwrap());
    let ((west, north), spacing) = (key.origin(), key.spacing());
    for (index, height) in heights.iter_mut().enumerate() {
        let (x, z) = ((index % VERTICES) as i32, (index / VERTICES) as i32);
        let place = Position::new(west + x * spacing, north + z * spacing).unwrap();
        *height = land.height_keeping(place, octaves);
    }
    error
}

/// The pixels of the smallest connected component of at least `least` pixels in which two pictures
/// differ visibly.
fn smallest_component(one: &Image, two: &Image, least: usize) -> Option<Vec<usize>> {
    let width = one.width as usize;
    let pixels = one.rgba.as_chunks::<4>().0.iter().zip(two.rgba.as_chunks::<4>().0);
    let mut is_left: Vec<bool> = pixels.map(|(a, b)| (0..3).any(|c| a[c].abs_diff(b[c]) > 24)).collect();
    let mut patches = Vec::new();
    for start in 0..is_left.len() {
        let (mut patch, mut open) = (Vec::new(), vec![start]);
        while let Some(at) = open.pop() {
            if std::mem::take(&mut is_left[at]) {
                patch.push(at);
                let (left, right) = (at % width > 0, at % width + 1 < width);
                open.extend(left.then(|| at - 1).into_iter().chain(right.then_some(at + 1)));
                open.extend(at.checked_sub(width).into_iter().chain(Some(at + width)));
                open.retain(|at| *at < is_left.len());
            }
        }
        patches.push(patch);
    }
    patches.into_iter().filter(|patch| patch.len() >= least).min_by_key(Vec::len)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn the_streamed_picture_equals_the_local_one_byte_for_byte() {
    let server = RunningServer::start().await;
    let url = server.stream_url();
    let compared = tokio::task::spawn_blocking(move || {
        let options = options(&START);
        let Some((local, _)) = render_or_skip(&options) else { return };
        let settings = Settings::new(url.parse().unwrap());
        let feed = ServerStream::connect(settings).unwrap();
        let (streamed, stats) = headless::render(&options, feed, Instant::now(), |_| {}).unwrap();
        assert!(local.rgba == streamed.rgba, "{:?}", Difference::between(&local, &streamed));
        assert!(stats.bytes_received > 100_000 && stats.chunks_drawn > 6, "{stats:?}");
    });
    compared.await.unwrap();
    server.stop().await;
}

/// The mean of pictures, in linear light.
fn mean(pictures: &[Image]) -> Image {
    let light = |byte: u8| (f64::from(byte) / 255.0).powf(2.2);
    let byte = |index: usize| {
        let sum: f64 = pictures.iter().map(|picture| light(picture.rgba[index])).sum();
        (255.0 * (sum / pictures.len() as f64).powf(1.0 / 2.2)).round() as u8
    };
    Image { rgba: (0..pictures[0].rgba.len()).map(byte).collect(), ..pictures[0].clone() }
}

/// The truth is the mean of pictures turned by fractions of a pixel, whose plants have the same
/// detail. Four samples of the triangles alone bring 0.83 of the error; leaves and impostors have
/// outlines within them.
#[test]
fn four_samples_a_pixel_smooth_the_outlines_of_trees() {
    let mut trees = plants();
    trees.settings.plants.density = 0;
    let projection = trees.projection;
    let pixel_deg = (projection.half_height() / f64::from(projection.height / 2)).atan().to_degrees();
    let turned = |east: f64, up: f64| {
        let mut options = trees.clone();
        options.pose.yaw_deg += east * pixel_deg;
        options.pose.pitch_deg += up * pixel_deg;
        render_or_skip(&options).map(|(picture, _)| picture)
    };
    let places = [-0.375, -0.125, 0.125, 0.375];
    let shifts = places.into_iter().zip([0.125, -0.375, 0.375, -0.125]);
    let Some(pictures) = shifts.map(|(east, up)| turned(east, up)).collect::<Option<Vec<_>>>() else {
        return;
    };
    let truth = mean(&pictures);
    // Above the horizon only trees have outlines: the ground has a texture, whose light is one for
    // the pixel.
    let sky = 4 * (truth.width * truth.height / 2) as usize;
    let differs = |index: &usize| {
        let bytes = pictures.iter().map(|picture| picture.rgba[*index]);
        bytes.clone().max() > bytes.min().map(|least| least.saturating_add(32))
    };
    let outlines: Vec<usize> = (0..sky).filter(|index| index % 4 < 3).filter(differs).collect();
    let error = |samples| {
        let (picture, _) = render_or_skip(&Options { samples, ..trees.clone() }).expect("drawn before");
        let off = outlines.iter().map(|index| u64::from(picture.rgba[*index].abs_diff(truth.rgba[*index])));
        off.sum::<u64>() as f64 / outlines.len() as f64
    };
    let (one, four) = (error(1), error(4));
    println!("{} bytes of outlines: {one:.1} off with one sample, {four:.1} with four", outlines.len());
    assert!(outlines.len() > 1000 && four < 0.7 * one, "{four} {one}");
}

#[test]
fn a_small_chunk_budget_costs_detail_and_leaves_no_holes() {
    let whole = Options { tolerance_px: 0.5, ..options(&START) };
    // The least budget that the viewer's option allows.
    let small = Options { chunk_bytes: 8 << 20, ..whole.clone() };
    let (Some((coarse, stats)), Some((fine, _))) = (render_or_skip(&small), render_or_skip(&whole)) else {
        return;
    };
    assert!(stats.chunk_bytes_resident <= small.chunk_bytes && stats.tolerance_px > 0.5, "{stats:?}");
    let difference = Difference::between(&coarse, &fine);
    assert!(difference.mean > 0.0 && difference.mean < 12.0, "coarser, but the same island: {difference:?}");
}
