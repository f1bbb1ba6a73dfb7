//! The wire format, frozen: one file of hexadecimal bytes for every message and every kind of
//! chunk.
//!
//! A failing test here means that deployed peers would no longer understand each other. If that is
//! intended, bump `PROTOCOL_VERSION` (or the chunk `VERSION`) and write the new bytes with
//! `TOMBOLO_BLESS=1 cargo test -p tombolo-protocol --test fixtures`.

use protocol::chunk_codec::{Effort, quantised, refined, seed_only};
use protocol::client::{ClientConfig, ClientSession};
use protocol::message::{
    ClientMessage, Hello, Limited, RefusalReason, Refused, Rejection, ServerMessage, Settled, Welcome,
    WireKey,
};
use protocol::server::{ServerOffer, ServerSession};
use protocol::view::View;
use protocol::{
    ControlError, DataFrame, Delivery, PROTOCOL_VERSION, PeerFault, Tolerance, chunk_codec, control,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fmt::Debug;
use std::path::PathBuf;
use terrain::{Chunk, ChunkKey, Land};

fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(format!("{name}.hex"))
}

/// The frozen bytes of a name; with `TOMBOLO_BLESS` set, writes them first.
fn frozen(name: &str, current: &[u8]) -> Vec<u8> {
    if std::env::var_os("TOMBOLO_BLESS").is_some() {
        let lines = current
            .chunks(32)
            .map(|line| line.iter().map(|byte| format!("{byte:02x}")).collect::<String>() + "\n");
        std::fs::write(path(name), lines.collect::<String>()).unwrap();
    }
    let text = std::fs::read_to_string(path(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    let digits: Vec<_> = text.chars().filter_map(|digit| digit.to_digit(16)).collect();
    digits.chunks(2).map(|pair| (pair[0] * 16 + pair[1]) as u8).collect()
}

fn check<M: Serialize + DeserializeOwned + Limited + PartialEq + Debug>(name: &str, message: &M) {
    let encoded = control::encode(message).unwrap();
    let bytes = frozen(name, &encoded);
    assert_eq!(
        control::decode::<M>(&bytes).as_ref(),
        Ok(message),
        "{name} no longer decodes to the same message"
    );
    assert_eq!(encoded, bytes, "{name} is no longer encoded as the same bytes");
}

#[test]
fn client_messages_are_frozen() {
    let keys = vec![WireKey { level: 3, x: -5, z: 70_000 }, WireKey { level: 16, x: 0, z: 0 }];
    check(
        "hello",
        &ClientMessage::Hello(Hello {
            digest: Some(std::array::from_fn(|index| index as u8)),
            delivery: Delivery::SeedOnly,
            token: Some("secret".into()),
            software: "fixture 1.0".into(),
        }),
    );
    let bare = Hello { digest: None, delivery: Delivery::Exact, token: None, software: String::new() };
    check("hello_bare", &ClientMessage::Hello(bare.clone()));
    let delivery = Delivery::Quantised(Tolerance::new(16).unwrap());
    check("hello_quantised", &ClientMessage::Hello(Hello { delivery, ..bare.clone() }));
    check("hello_refined", &ClientMessage::Hello(Hello { delivery: Delivery::Refined, ..bare }));
    check(
        "view",
        &ClientMessage::View(View {
            id: 0x0102_0304,
            eye: [-256, 25_600, 1 << 30],
            velocity: [1, -2, 3],
            yaw_mdeg: -90_000,
            pitch_mdeg: 12_345,
            fov_mdeg: 60_000,
            viewport: [1280, 720],
            tolerance_q4: 32,
            distance_m: 8000,
        }),
    );
    check("credit", &ClientMessage::Credit { chunks: 64 });
    check("request", &ClientMessage::Request { id: 9, keys: keys.clone() });
    check("release", &ClientMessage::Release { keys: keys.clone() });
    check("holding", &ClientMessage::Holding { keys });
    check("credit_bytes", &ClientMessage::CreditBytes { bytes: 1_000_000 });
    check("cancel", &ClientMessage::Cancel { id: 9 });
}

#[test]
fn server_messages_are_frozen() {
    check(
        "welcome",
        &ServerMessage::Welcome(Welcome {
            session: 0x1122_3344_5566_7788,
            world_seed: 42,
            generator_version: 1,
            digest: [0xab; 32],
            max_credits: 4096,
            max_view_distance_m: 65_536,
            software: "fixture 1.0".into(),
        }),
    );
    let rejected = ServerMessage::Rejected;
    check("rejected_version", &rejected(Rejection::WrongVersion { client: 2, server: 1 }));
    check("rejected_world", &rejected(Rejection::WrongWorld { client: [1; 32], server: [2; 32] }));
    check("rejected_unauthorised", &rejected(Rejection::Unauthorised));
    check("settled", &ServerMessage::Settled(Settled { view: 7, chunks: 396 }));
    for (name, reason) in [
        ("refused_outside_world", RefusalReason::OutsideWorld),
        ("refused_invalid_view", RefusalReason::InvalidView),
        ("refused_too_many_requests", RefusalReason::TooManyRequests),
        ("refused_overloaded", RefusalReason::Overloaded),
        ("refused_failed", RefusalReason::Failed),
        ("refused_duplicate", RefusalReason::Duplicate),
        ("refused_invalid_credit", RefusalReason::InvalidCredit),
    ] {
        let key = (reason == RefusalReason::OutsideWorld).then_some(WireKey { level: 17, x: 1, z: -1 });
        check(name, &ServerMessage::Refused(Refused { id: 5, key, reason, detail: "why".into() }));
    }
    check("draining", &ServerMessage::Draining { reconnect_after_ms: 1500 });
}

#[test]
fn older_versions_are_rejected_with_both_versions() {
    // Never blessed: these are the bytes of those releases.
    let read = |name: &str| {
        let text = std::fs::read_to_string(path(name)).unwrap();
        let digits: Vec<_> = text.chars().filter_map(|digit| digit.to_digit(16)).collect();
        digits.chunks(2).map(|pair| (pair[0] * 16 + pair[1]) as u8).collect::<Vec<_>>()
    };
    for version in 1..PROTOCOL_VERSION {
        let old = read(&format!("version_{version}/hello"));
        assert_eq!(
            control::decode::<ClientMessage>(&old),
            Err(ControlError::Version { theirs: version, ours: PROTOCOL_VERSION })
        );
        let land = Land::new(1);
        let offer = ServerOffer { land, digest: land.digest(), token: None, software: String::new() };
        let fault = ServerSession::new(offer, 1).receive(DataFrame::Binary(&old)).unwrap_err();
        let rejection = Rejection::WrongVersion { client: version, server: PROTOCOL_VERSION };
        assert_eq!(fault, PeerFault::Rejected(rejection));
        let both = format!("version {version}, the server {PROTOCOL_VERSION}");
        assert!(fault.to_string().contains(&both), "{fault}");

        let config = ClientConfig {
            digest: None,
            delivery: Delivery::Exact,
            token: None,
            software: String::new(),
            window: 1,
        };
        let welcome = read(&format!("version_{version}/welcome"));
        let fault = ClientSession::new(config).receive(DataFrame::Binary(&welcome)).unwrap_err();
        let both = format!("version {PROTOCOL_VERSION}, the server {version}");
        assert!(fault.to_string().contains(&both), "{fault}");
    }
}

#[test]
fn a_seed_only_chunk_is_frozen() {
    let land = Land::new(42);
    let chunk = land.chunk(ChunkKey::new(2, -3, 1).unwrap());
    let encoded = seed_only::encode(&chunk, &land.digest());
    let bytes = frozen("chunk_seed_only", &encoded);
    assert_eq!(seed_only::decode(&bytes, &land, &land.digest()), Ok(chunk));
    assert_eq!(encoded, bytes);
}

#[test]
fn chunks_with_heights_are_frozen() {
    let land = Land::new(42);
    let world = land.digest();
    // Only decoding is frozen: a better compressor may choose other bytes for the same chunk.
    let chunk = land.chunk(ChunkKey::new(2, -3, 1).unwrap());
    let bytes = frozen("chunk", &chunk_codec::encode(&chunk, &world));
    assert_eq!(chunk_codec::decode(&bytes, &world), Ok(chunk.clone()));

    let tolerance = Tolerance::new(16).unwrap();
    let coarse = quantised::quantise(&chunk, tolerance).unwrap();
    let frame = quantised::encode(&chunk, &world, tolerance, Effort::Compact).unwrap();
    let bytes = frozen("chunk_quantised", &frame);
    assert_eq!(quantised::decode(&bytes, &world, tolerance), Ok(coarse));

    let child = land.chunk(chunk.key.children().unwrap()[2]);
    let frame = refined::encode(&child, &chunk, &world, Effort::Compact).unwrap();
    let bytes = frozen("chunk_refined", &frame);
    assert_eq!(refined::decode(&bytes, &world, &chunk), Ok(child));

    let mut meadow = chunk;
    (0..=255).for_each(|block: u8| meadow.grass.density[usize::from(block)] = block);
    let bytes = frozen("chunk_meadow", &chunk_codec::encode(&meadow, &world));
    assert_eq!(chunk_codec::decode(&bytes, &world), Ok(meadow));
}

/// The page for authors of other implementations has the digests that their decoders must find.
#[test]
fn the_page_of_the_fixtures_has_their_digests() {
    let page = include_str!("../fixtures/README.md");
    let land = Land::new(42);
    let chunk = land.chunk(ChunkKey::new(2, -3, 1).unwrap());
    let coarse = quantised::quantise(&chunk, Tolerance::new(16).unwrap()).unwrap();
    let child = land.chunk(chunk.key.children().unwrap()[2]);
    assert_eq!(child.key, ChunkKey::new(1, -6, 3).unwrap());
    let of_heights = |chunk: &Chunk| {
        let bytes: Vec<u8> = chunk.heights.iter().flat_map(|height| height.to_le_bytes()).collect();
        blake3::hash(&bytes).to_string()
    };
    let digests = [land.digest().to_string(), of_heights(&chunk), of_heights(&coarse), of_heights(&child)];
    let absent: Vec<_> = digests.iter().filter(|digest| !page.contains(digest.as_str())).collect();
    assert!(absent.is_empty(), "of the world and of three chunks the page lacks {absent:#?}");
}
