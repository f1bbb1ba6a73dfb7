//! The harness itself: comparisons that must fail, and the table of suites.

use client::gpu::Image;
use tests::RunningServer;
use tests::golden::{Difference, check, is_blessing};
use tests::peer::Peer;

fn picture(value: u8) -> Image {
    Image { width: 8, height: 8, rgba: vec![value; 8 * 8 * 4] }
}

#[test]
fn a_difference_has_a_mean_and_a_share_of_outliers() {
    let uniform = Difference { mean: 3.0, outliers: 0.0, block: 3.0 };
    assert_eq!(Difference::between(&picture(100), &picture(103)), uniform);
    let mut spot = picture(100);
    spot.rgba[0] = 200;
    let difference = Difference::between(&picture(100), &spot);
    assert!((difference.outliers - 1.0 / 64.0).abs() < 1e-9 && !difference.is_tolerable());
    let larger = Image { width: 16, height: 4, rgba: vec![100; 256] };
    assert!(!Difference::between(&picture(100), &larger).is_tolerable());
}

#[test]
fn a_difference_in_one_block_is_not_diluted_by_the_others() {
    let large = Image { width: 160, height: 90, rgba: vec![100; 160 * 90 * 4] };
    let mut changed = large.clone();
    // The last block is 16 x 10 pixels.
    let (first_row, first_column) = (80, 144);
    for row in first_row..90 {
        changed.rgba[(row * 160 + first_column) * 4..][..16 * 4].fill(110);
    }
    let difference = Difference::between(&large, &changed);
    assert_eq!((difference.block, difference.outliers), (10.0, 0.0));
    assert!(difference.mean < 0.2 && !difference.is_tolerable());
}

#[test]
fn a_missing_golden_picture_is_an_error() {
    if !is_blessing() {
        assert!(check("no-such-picture", &picture(1)).is_err());
    }
}

#[tokio::test]
async fn a_stopped_server_refuses_connections() {
    let server = RunningServer::start().await;
    let url = server.stream_url();
    server.stop().await;
    assert!(Peer::try_connect(&url, Some(protocol::SUBPROTOCOL)).await.is_err());
}

#[test]
fn the_table_of_suites_lists_every_file() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests");
    let mut suites: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "rs"))
        .map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned())
        .collect();
    suites.sort();
    let row = |line: &'static str| line.strip_prefix("//! | `")?.split_once('`').map(|(name, _)| name);
    let listed: Vec<&str> = include_str!("../src/lib.rs").lines().filter_map(row).collect();
    assert_eq!(listed, suites, "the table in tests/src/lib.rs and the files in tests/tests");
}
