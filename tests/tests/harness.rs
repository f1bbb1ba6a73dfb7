//! The harness itself: comparisons that must fail, and the table of suites.

use client::gpu::Image;
use tests::RunningServer;
use tests::golden::{Difference, check};
use tests::peer::Peer;

fn picture(value: u8) -> Image {
    Image { width: 8, height: 8, rgba: vec![value; 8 * 8 * 4] }
}

#[test]
fn a_difference_has_a_mean_and_a_share_of_outliers() {
    assert_eq!(Difference::between(&picture(100), &picture(103)), Difference { mean: 3.0, outliers: 0.0 });
    let mut spot = picture(100);
    spot.rgba[0] = 200;
    let difference = Difference::between(&picture(100), &spot);
    assert!((difference.outliers - 1.0 / 64.0).abs() < 1e-9 && !difference.is_tolerable());
    let larger = Image { width: 16, height: 4, rgba: vec![100; 256] };
    assert!(!Difference::between(&picture(100), &larger).is_tolerable());
}

#[test]
fn a_missing_golden_picture_is_an_error() {
    if std::env::var_os("TOMBOLO_BLESS").is_none() {
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
