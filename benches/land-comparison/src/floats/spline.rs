//! The base field of a chunk as quadratic B-splines of nodes 32 m apart, as the land does it.

use super::base::{Base, FloatLobe, Node};
use super::hash::Hash;
use super::lanes::{COUNT, F8, I8};
use terrain::spline::{CELL_BITS, cell, node};

/// Nodes along one side of a chunk of level 0: one before it, four in it and one after.
const SIDE: usize = 6;
/// Numbers of a field of nodes, with room for a vector beyond the last row and for a row without
/// weight.
const STORED: usize = (SIDE + 1) * SIDE + COUNT;
/// Vertices of a cell.
const CELL: usize = 16;

/// The nodes of a chunk: heights, roughness, exposure.
pub struct Nodes([[f32; STORED]; 3]);

/// The nodes of the field interpolated to one row or column of vertices: one of each cell along it.
pub struct Line([[f32; COUNT]; 3]);

impl Nodes {
    /// Evaluates the nodes of the chunk of a low corner, units.
    #[inline(always)]
    pub fn new<H: Hash>(base: &Base, lobes: &[FloatLobe], (x, z): (i32, i32)) -> Self {
        let first = (cell(x).0 - 1, cell(z).0 - 1);
        let mut nodes = Self([[0.0; STORED]; 3]);
        for at in (0..SIDE * SIDE).step_by(COUNT) {
            let (mut xs, mut zs) = ([0; COUNT], [0; COUNT]);
            for lane in 0..COUNT {
                xs[lane] = node(first.0 + ((at + lane) % SIDE) as i32);
                zs[lane] = node(first.1 + ((at + lane) / SIDE) as i32);
            }
            let found = base.at::<H>(lobes, I8::load(&xs), I8::load(&zs));
            for (stored, found) in nodes.0.iter_mut().zip([found.height, found.roughness, found.exposure]) {
                store(found, stored, at);
            }
        }
        nodes
    }

    /// Splines along z at a row of vertices.
    #[inline(always)]
    pub fn row(&self, row: usize) -> Line {
        let [a, b, c] = weights_at(row);
        let first = row / CELL * SIDE;
        let mut line = Line([[0.0; COUNT]; 3]);
        for (line, nodes) in line.0.iter_mut().zip(&self.0) {
            let sum = load(nodes, first) * F8::splat(a);
            let sum = load(nodes, first + SIDE).mul_add(F8::splat(b), sum);
            load(nodes, first + 2 * SIDE).mul_add(F8::splat(c), sum).store(line);
        }
        line
    }

    /// Splines along x at the last column of vertices, where the node after has no weight.
    #[inline(always)]
    pub fn last_column(&self) -> Line {
        let mut line = Line([[0.0; COUNT]; 3]);
        for (line, nodes) in line.0.iter_mut().zip(&self.0) {
            for row in 0..SIDE {
                line[row] = 0.5 * (nodes[row * SIDE + SIDE - 2] + nodes[row * SIDE + SIDE - 1]);
            }
        }
        line
    }
}

/// Weights of three nodes at the vertices of one vector: the first or the second half of a cell.
#[derive(Clone, Copy)]
pub struct Weights([[F8; 3]; 2]);

impl Weights {
    /// Both halves.
    #[inline(always)]
    pub fn new() -> Self {
        let mut halves = [[F8::splat(0.0); 3]; 2];
        for (half, weights) in halves.iter_mut().enumerate() {
            let first = (half * COUNT) as f32 / CELL as f32;
            let t = I8::ramp().to_floats().mul_add(F8::splat(1.0 / CELL as f32), F8::splat(first));
            let rest = F8::splat(1.0) - t;
            let a = rest * rest * F8::splat(0.5);
            let c = t * t * F8::splat(0.5);
            *weights = [a, F8::splat(1.0) - a - c, c];
        }
        Self(halves)
    }
}

impl Line {
    /// The field at a vector of vertices of the line.
    #[inline(always)]
    pub fn at(&self, vector: usize, weights: &Weights) -> Node {
        let (first, weights) = (vector / 2, weights.0[vector % 2]);
        let [height, roughness, exposure] = &self.0;
        Node {
            height: spline(height, first, weights),
            roughness: spline(roughness, first, weights),
            exposure: spline(exposure, first, weights),
        }
    }
}

#[inline(always)]
fn spline(line: &[f32; COUNT], first: usize, [a, b, c]: [F8; 3]) -> F8 {
    let sum = F8::splat(line[first + 1]).mul_add(b, F8::splat(line[first]) * a);
    F8::splat(line[first + 2]).mul_add(c, sum)
}

fn weights_at(vertex: usize) -> [f32; 3] {
    const { assert!(CELL << terrain::constants::SPACING_BITS == 1 << CELL_BITS) };
    let t = (vertex % CELL) as f32 / CELL as f32;
    let (a, c) = (0.5 * (1.0 - t) * (1.0 - t), 0.5 * t * t);
    [a, 1.0 - a - c, c]
}

#[inline(always)]
fn load(from: &[f32; STORED], at: usize) -> F8 {
    F8::load(from[at..at + COUNT].first_chunk().expect("a vector"))
}

#[inline(always)]
fn store(lanes: F8, to: &mut [f32; STORED], at: usize) {
    lanes.store(to[at..at + COUNT].first_chunk_mut().expect("a vector"));
}
