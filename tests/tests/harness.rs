//! That the harness itself fails when it should.

use client::render::Picture;
use tests::RunningServer;
use tests::golden::{Difference, check};
use tests::peer::Peer;

fn picture(value: u8) -> Picture {
    Picture { width: 8, height: 8, rgba: vec![value; 8 * 8 * 4] }
}

#[test]
fn a_difference_is_measured_in_both_measures() {
    assert_eq!(Difference::between(&picture(100), &picture(103)), Difference { mean: 3.0, outliers: 0.0 });
    let mut spot = picture(100);
    spot.rgba[0] = 200;
    let difference = Difference::between(&picture(100), &spot);
    assert!((difference.outliers - 1.0 / 64.0).abs() < 1e-9 && !difference.is_tolerable());
    let larger = Picture { width: 16, height: 4, rgba: vec![100; 256] };
    assert!(!Difference::between(&picture(100), &larger).is_tolerable());
}

#[test]
fn a_missing_golden_picture_is_an_error() {
    if std::env::var_os("TOMBOLO_BLESS").is_none() {
        assert!(check("no-such-picture", &picture(1)).is_err());
    }
}

#[tokio::test]
async fn a_stopped_server_is_gone() {
    let server = RunningServer::start().await;
    let url = server.stream_url();
    server.stop().await;
    assert!(Peer::try_connect(&url, Some(protocol::SUBPROTOCOL)).await.is_err());
}
