//! Common codecs of heights: u16 above the lowest vertex, 65 x 65.
//!
//! Each in its own format, with an encoder that is common in Rust. LERC, whose only crate
//! compiles a C++ library, is in `benches/lerc`.

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use image_webp::{ColorType, WebPDecoder, WebPEncoder};
use std::cell::RefCell;
use std::io::{Cursor, Read, Write};
use terrain::constants::{VERTEX_COUNT, VERTICES};
use zstd::bulk::{Compressor, Decompressor};

/// A codec of u16 heights. A failed decoding returns no height, which counts as a loss.
#[derive(Clone, Copy)]
pub(super) struct Baseline {
    pub(super) codec: &'static str,
    pub(super) encode: fn(&[u16]) -> Vec<u8>,
    pub(super) decode: fn(&[u8]) -> Vec<u16>,
}

/// Name of the nearest competitor: our predictor, compressed as it is.
pub(super) const PLANE_ZSTD: &str = "plane, byte planes, one zstd 1 frame";

/// Name of 16-bit PNG.
pub(super) const PNG16: &str = "PNG, 16 bits, adaptive filters";

/// Name of the coding that quantized-mesh has for heights (zigzag differences in the order of the
/// vertices, then gzip), here of our grid and not in that format.
pub(super) const SCAN_DELTA: &str = "scan deltas, zigzag, gzip 6";

pub(super) fn all() -> Vec<Baseline> {
    vec![
        Baseline { codec: "u16 as it is", encode: words, decode: from_words },
        Baseline { codec: PLANE_ZSTD, encode: plane_zstd, decode: from_plane_zstd },
        Baseline { codec: PNG16, encode: png, decode: from_png },
        Baseline { codec: SCAN_DELTA, encode: scan_delta, decode: from_scan_delta },
        Baseline { codec: "WebP lossless, terrain-RGB", encode: webp, decode: from_webp },
    ]
}

fn words(heights: &[u16]) -> Vec<u8> {
    heights.iter().flat_map(|height| height.to_le_bytes()).collect()
}

fn from_words(bytes: &[u8]) -> Vec<u16> {
    bytes.as_chunks().0.iter().map(|word| u16::from_le_bytes(*word)).collect()
}

const fn zigzag(difference: u16) -> u16 {
    (difference << 1) ^ ((difference as i16 >> 15) as u16)
}

const fn unzigzag(word: u16) -> u16 {
    (word >> 1) ^ (word & 1).wrapping_neg()
}

/// Contexts of a thread, as in a server.
struct Contexts {
    compressor: Option<Compressor<'static>>,
    decompressor: Option<Decompressor<'static>>,
    /// Low and high bytes of the residuals of a chunk.
    planes: [u8; 2 * VERTEX_COUNT],
}

thread_local! {
    static CONTEXTS: RefCell<Contexts> = RefCell::new(Contexts {
        compressor: Compressor::new(1).ok(),
        decompressor: Decompressor::new().ok(),
        planes: [0; 2 * VERTEX_COUNT],
    });
}

/// Plane prediction of a height from those before it.
fn predicted(heights: &[u16], index: usize) -> u16 {
    match (index % VERTICES, index / VERTICES) {
        (0, 0) => 0,
        (_, 0) => heights[index - 1],
        (0, _) => heights[index - VERTICES],
        _ => heights[index - 1]
            .wrapping_add(heights[index - VERTICES])
            .wrapping_sub(heights[index - VERTICES - 1]),
    }
}

fn plane_zstd(heights: &[u16]) -> Vec<u8> {
    let mut planes = vec![0; 2 * heights.len()];
    let (low, high) = planes.split_at_mut(heights.len());
    for index in 0..heights.len() {
        let [lower, upper] = zigzag(heights[index].wrapping_sub(predicted(heights, index))).to_le_bytes();
        (low[index], high[index]) = (lower, upper);
    }
    CONTEXTS
        .with_borrow_mut(|contexts| contexts.compressor.as_mut()?.compress(&planes).ok())
        .unwrap_or_default()
}

/// Row by row: the difference of a height from the one above it is the sum of the residuals of its
/// row so far.
fn from_plane_zstd(bytes: &[u8]) -> Vec<u16> {
    CONTEXTS.with_borrow_mut(|Contexts { decompressor, planes, .. }| {
        let zstd = decompressor.as_mut();
        let size = zstd.and_then(|zstd| zstd.decompress_to_buffer(bytes, &mut planes[..]).ok());
        if size != Some(planes.len()) {
            return Vec::new();
        }
        let (low, high) = planes.split_at(VERTEX_COUNT);
        let mut heights = Vec::with_capacity(VERTEX_COUNT);
        let mut above = [0_u16; VERTICES];
        for (low, high) in low.chunks_exact(VERTICES).zip(high.chunks_exact(VERTICES)) {
            let mut difference = 0_u16;
            for ((height, low), high) in above.iter_mut().zip(low).zip(high) {
                difference = difference.wrapping_add(unzigzag(u16::from_le_bytes([*low, *high])));
                *height = height.wrapping_add(difference);
            }
            heights.extend_from_slice(&above);
        }
        heights
    })
}

fn png(heights: &[u16]) -> Vec<u8> {
    let big_endian: Vec<u8> = heights.iter().flat_map(|height| height.to_be_bytes()).collect();
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, VERTICES as u32, VERTICES as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    encoder.set_filter(png::Filter::Adaptive);
    let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(&big_endian));
    if written.is_ok() { out } else { Vec::new() }
}

fn from_png(bytes: &[u8]) -> Vec<u16> {
    let read = || {
        let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().ok()?;
        let mut image = vec![0; reader.output_buffer_size()?];
        reader.next_frame(&mut image).ok()?;
        Some(image.as_chunks().0.iter().map(|word| u16::from_be_bytes(*word)).collect())
    };
    read().unwrap_or_default()
}

fn scan_delta(heights: &[u16]) -> Vec<u8> {
    let mut before = 0;
    let deltas: Vec<u16> = heights
        .iter()
        .map(|height| {
            let delta = zigzag(height.wrapping_sub(before));
            before = *height;
            delta
        })
        .collect();
    let mut encoder = GzEncoder::new(Vec::new(), Compression::new(6));
    // Writing to memory cannot fail.
    encoder.write_all(&words(&deltas)).and_then(|()| encoder.finish()).unwrap_or_default()
}

fn from_scan_delta(bytes: &[u8]) -> Vec<u16> {
    let mut deltas = Vec::new();
    if GzDecoder::new(bytes).read_to_end(&mut deltas).is_err() {
        return Vec::new();
    }
    let mut before = 0u16;
    from_words(&deltas)
        .into_iter()
        .map(|delta| {
            before = before.wrapping_add(unzigzag(delta));
            before
        })
        .collect()
}

fn webp(heights: &[u16]) -> Vec<u8> {
    let rgb: Vec<u8> = heights
        .iter()
        .flat_map(|height| {
            let [high, low] = height.to_be_bytes();
            [0, high, low]
        })
        .collect();
    let mut out = Vec::new();
    let (width, height) = (VERTICES as u32, VERTICES as u32);
    match WebPEncoder::new(&mut out).encode(&rgb, width, height, ColorType::Rgb8) {
        Ok(()) => out,
        Err(_) => Vec::new(),
    }
}

fn from_webp(bytes: &[u8]) -> Vec<u16> {
    let read = || {
        let mut decoder = WebPDecoder::new(Cursor::new(bytes)).ok()?;
        let mut rgb = vec![0; decoder.output_buffer_size()?];
        decoder.read_image(&mut rgb).ok()?;
        Some(rgb.as_chunks::<3>().0.iter().map(|[_, high, low]| u16::from_be_bytes([*high, *low])).collect())
    };
    read().unwrap_or_default()
}
