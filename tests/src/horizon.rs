//! The land's horizon by its definition, in f64: the reference of shadows on the GPU.
//!
//! Every drawn chunk that a track crosses is tested at every crossing of its mesh. No pyramid, no
//! page table, no stepping; the only rule shared with the shader is the diagonal of a cell from its
//! low to its high corner.

use client::cache::Resident;
use shaders::layout::{CLEARANCE_RANGE, SUN_RADIUS};
use terrain::ChunkKey;
use terrain::constants::{CELLS, VERTICES};

/// Some drawn chunks.
#[derive(Debug)]
pub struct Drawn<'a> {
    /// The drawn chunks; none covers another.
    pub chunks: Vec<(ChunkKey, &'a Resident)>,
}

/// Units of the nearest tested crossing. The nearest possible one is 0.35 vertex spacings of level
/// 0 away.
const NEAREST: f64 = 128.0;

impl Drawn<'_> {
    /// How far the middle of the sun stands above the horizon at a place (units), in radii of the
    /// sun, within the kept range. `azimuth` clockwise from north and `elevation` are radians.
    #[must_use]
    pub fn clearance(&self, place: (i64, i64), azimuth: f64, elevation: f64) -> f64 {
        let toward = (azimuth.sin(), -azimuth.cos());
        let start =
            self.chunks.iter().filter_map(|chunk| drawn_height(chunk, (place.0 as f64, place.1 as f64)));
        let start = start.fold(0.0, f64::max);
        let horizon = self.chunks.iter().flat_map(|chunk| {
            crossings(chunk.0, place, toward).into_iter().filter_map(move |ahead| {
                let point = (place.0 as f64 + toward.0 * ahead, place.1 as f64 + toward.1 * ahead);
                drawn_height(chunk, point).map(|height| (height - start) / ahead)
            })
        });
        let angle = horizon.fold(0.0, f64::max).atan();
        ((elevation - angle) / SUN_RADIUS).clamp(-CLEARANCE_RANGE, CLEARANCE_RANGE)
    }
}

/// Where a track crosses columns, rows and diagonals of a chunk's mesh, units ahead, ends included.
fn crossings(key: ChunkKey, place: (i64, i64), toward: (f64, f64)) -> Vec<f64> {
    let (x, z) = key.origin();
    let low = ((i64::from(x) - place.0) as f64, (i64::from(z) - place.1) as f64);
    let (side, spacing) = (f64::from(key.side()), f64::from(key.spacing()));
    let span = |low: f64, toward: f64| {
        if toward.abs() < 1e-12 {
            return if low <= 0.0 && low + side >= 0.0 { (0.0, f64::INFINITY) } else { (1.0, 0.0) };
        }
        let ends = (low / toward, (low + side) / toward);
        (ends.0.min(ends.1), ends.0.max(ends.1))
    };
    let (east, south) = (span(low.0, toward.0), span(low.1, toward.1));
    let (near, far) = (east.0.max(south.0).max(NEAREST), east.1.min(south.1));
    if near > far {
        return Vec::new();
    }
    let lines = |low: f64, toward: f64, count: std::ops::RangeInclusive<i32>| {
        count.map(move |line| (low + f64::from(line) * spacing) / toward)
    };
    let cells = CELLS as i32;
    let columns = lines(low.0, toward.0, 0..=cells);
    let rows = lines(low.1, toward.1, 0..=cells);
    let diagonals = lines(low.0 - low.1, toward.0 - toward.1, -cells..=cells);
    let inside = columns.chain(rows).chain(diagonals).filter(|ahead| (near..=far).contains(ahead));
    inside.chain([near, far]).collect()
}

/// Height of a chunk's triangles at a point (units), units; none beside it.
fn drawn_height((key, chunk): &(ChunkKey, &Resident), point: (f64, f64)) -> Option<f64> {
    let (x, z) = key.origin();
    let spacing = f64::from(key.spacing());
    let at = ((point.0 - f64::from(x)) / spacing, (point.1 - f64::from(z)) / spacing);
    let last = CELLS as f64;
    let reach = -1e-6..=last + 1e-6;
    if !reach.contains(&at.0) || !reach.contains(&at.1) {
        return None;
    }
    let cell = (at.0.floor().clamp(0.0, last - 1.0), at.1.floor().clamp(0.0, last - 1.0));
    let (u, v) = (at.0 - cell.0, at.1 - cell.1);
    let height = |dx: usize, dz: usize| {
        f64::from(chunk.heights[(cell.1 as usize + dz) * VERTICES + cell.0 as usize + dx])
    };
    let (low, high) = (height(0, 0), height(1, 1));
    Some(if u >= v {
        low + u * (height(1, 0) - low) + v * (high - height(1, 0))
    } else {
        low + v * (height(0, 1) - low) + u * (high - height(0, 1))
    })
}
