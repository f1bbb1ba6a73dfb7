//! Numbers of `docs/protocol.md` against the code that they describe: a client is written from that
//! page.

use protocol::message::{ClientMessage, Hello};
use protocol::{CloseCode, Delivery, chunk_codec, control, limits};
use terrain::constants::CELLS;
use terrain::{ChunkKey, Land};

const PAGE: &str = include_str!("../../docs/protocol.md");

/// Bytes in front of the fields of a control message: magic, version, index of the variant.
const CONTROL_PREFIX: usize = 4 + 2 + 4;

/// The page as one line.
fn page() -> String {
    PAGE.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A number as the page writes it: `15,120`.
fn grouped(number: usize) -> String {
    let digits = number.to_string();
    let groups: Vec<_> =
        digits.as_bytes().rchunks(3).rev().map(|group| str::from_utf8(group).unwrap()).collect();
    groups.join(",")
}

fn states(sentence: &str) {
    assert!(page().contains(sentence), "docs/protocol.md does not say `{sentence}`");
}

#[test]
fn sizes_of_frames_are_those_of_the_code() {
    assert_eq!(grouped(15_120), "15,120");
    assert_eq!((grouped(36), grouped(268_435_456)), ("36".into(), "268,435,456".into()));
    let longest = grouped(limits::MAX_CHUNK_FRAME);
    states(&format!("Control frames are at most {} bytes.", grouped(limits::MAX_CONTROL_FRAME)));
    states(&format!("Chunk frames are at most {longest} bytes."));
    states(&format!("({longest} bytes, or {} in SeedOnly)", limits::SEED_ONLY_FRAME));
    states(&format!("bytes of the payload, at most {}", grouped(limits::MAX_PAYLOAD)));
    states(&format!("a message of {} bytes or more", grouped(limits::MAX_CONTROL_FRAME + 1)));
    states(&format!("longer than {} bytes", grouped(limits::MAX_CONTROL_FRAME)));
    states(&format!("| {} | the grass record: seed u32, palette u8", limits::GRASS_RECORD));
    assert_eq!(limits::MAX_SERVER_FRAME, limits::MAX_CHUNK_FRAME.max(limits::MAX_CONTROL_FRAME));
}

#[test]
fn a_view_has_as_many_bytes_as_the_page_says() {
    let bytes = control::encode(&ClientMessage::View(test_support::view(1, 100))).unwrap().len();
    states(&format!("{} bytes after the variant index", bytes - CONTROL_PREFIX));
    // The control: the prefix is that of another message, too.
    let hello = Hello { digest: None, delivery: Delivery::Exact, token: None, software: String::new() };
    assert_eq!(control::encode(&ClientMessage::Hello(hello)).unwrap().len(), CONTROL_PREFIX + 1 + 4 + 1 + 8);
}

#[test]
fn limits_of_a_session_are_those_of_the_code() {
    states(&format!("a list of more than {} keys", limits::MAX_KEYS));
    states(&format!("a text of more than {} bytes", limits::MAX_TEXT));
    states(&format!("at most {} are counted", grouped(limits::MAX_CREDITS as usize)));
    states(&format!("{} bytes (256 MiB) are counted", grouped(limits::MAX_CREDIT_BYTES as usize)));
    states(&format!("At most {} requested keys", grouped(limits::MAX_PENDING_REQUESTS)));
    // Held and forgotten chunks.
    states(&format!("in tiles of {0} x {0} of a level", limits::HELD_TILE));
    states(&format!("at most {} tiles. A full set is cleared", grouped(limits::MAX_HELD_TILES)));
    states(&format!("the latest {} chunks of levels 1 and 2", grouped(limits::MAX_REFERENCES)));
    // Limits of the cost of a view.
    states(&format!("needs more than {} chunks gets the first", grouped(limits::MAX_VIEW_CHUNKS)));
    states(&format!("exceeds {} is refused", grouped(limits::MAX_VIEW_ESTIMATE as usize)));
}

#[test]
fn every_close_code_is_in_the_table_and_no_other() {
    let table = PAGE.split("## 3. Close codes").nth(1).unwrap().split("\n## ").next().unwrap();
    let rows =
        table.lines().filter_map(|line| line.strip_prefix("| ")?.split(' ').next()?.parse::<u16>().ok());
    let listed: Vec<_> = rows.collect();
    let known: Vec<_> = (1000..5000).filter(|code| CloseCode::from_code(*code).is_some()).collect();
    assert_eq!(listed, known);
}

#[test]
fn the_slope_of_a_frame_is_that_of_the_formula() {
    let land = Land::new(1);
    for key in [(0, 3, -7), (0, 12, 5), (2, 1, -2), (4, 0, 0), (9, 0, 0)] {
        let key = ChunkKey::new(key.0, key.1, key.2).unwrap();
        let chunk = land.chunk(key);
        let h = |i: usize, j: usize| i64::from(chunk.vertex(i, j));
        let mut largest = 0_i64;
        for (i, j) in (0..CELLS).flat_map(|j| (0..CELLS).map(move |i| (i, j))) {
            let square = |one: i64, other: i64| (one - other) * (one - other);
            let north = square(h(i + 1, j), h(i, j)) + square(h(i + 1, j + 1), h(i + 1, j));
            let south = square(h(i + 1, j + 1), h(i, j + 1)) + square(h(i, j + 1), h(i, j));
            largest = largest.max(north).max(south);
        }
        let root = (0..).find(|root: &i64| root * root >= largest).unwrap();
        let spacing = 512 << key.level();
        let expected = (256 * root + spacing - 1) / spacing;
        let frame = chunk_codec::encode(&chunk, &land.digest());
        let sent = u32::from_le_bytes(frame[32..36].try_into().unwrap());
        assert_eq!(i64::from(sent), expected, "{key}");
    }
}
