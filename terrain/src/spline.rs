//! Uniform quadratic B-splines over the base lattice (de Boor, "A Practical Guide to Splines",
//! 1978): smooth, local to 3 x 3 nodes, and inside the hull of their nodes.
//!
//! Nodes lie in the middles of cells of 2^13 units (32 m). Inside a cell, at the fraction `t`, a
//! spline of the nodes `a, b, c` of the cell before, of the cell and of the cell after is
//! `(a + b) / 2 + (b - a) t + (a - 2b + c) t² / 2`.

use crate::ring::mul_hi;

/// log2 of the side of a cell of the base lattice, units.
pub const CELL_BITS: u32 = 13;

/// The cell of a coordinate, and the fraction of the cell, Q13.
#[must_use]
#[inline]
pub const fn cell(coordinate: i32) -> (i32, i32) {
    (coordinate >> CELL_BITS, coordinate & ((1 << CELL_BITS) - 1))
}

/// Position of the node of a cell, units.
#[must_use]
#[inline]
pub const fn node(cell: i32) -> i32 {
    (cell << CELL_BITS) + (1 << (CELL_BITS - 1))
}

/// The spline of heights, 2^-16 m. Differences of neighbours are below 2^29.
#[must_use]
#[inline]
pub const fn height([a, b, c]: [i32; 3], t_q13: i32) -> i32 {
    let (rise, bend) = (b - a, (c - b) - (b - a));
    ((a + b) >> 1)
        + mul_hi(rise << 1, t_q13 << (31 - CELL_BITS))
        + mul_hi(bend, (t_q13 * t_q13) << (31 - 2 * CELL_BITS))
}

/// The weights of three nodes at a fraction of the cell, Q15; their sum is one.
#[must_use]
#[inline]
pub const fn weights(t_q13: i32) -> [i32; 3] {
    let rest = (1 << CELL_BITS) - t_q13;
    let (before, after) = ((rest * rest) >> (2 * CELL_BITS - 14), (t_q13 * t_q13) >> (2 * CELL_BITS - 14));
    [before, (1 << 15) - before - after, after]
}

/// The spline of shares, Q15, rounded to nearest: 16-bit factors, as a paired product takes them.
#[must_use]
#[inline]
pub const fn share([a, b, c]: [i32; 3], weights: [i32; 3]) -> i32 {
    (a * weights[0] + b * weights[1] + c * weights[2] + (1 << 14)) >> 15
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hash::mix;

    #[test]
    fn splines_lie_in_the_hull_of_their_nodes_and_near_the_stated_sum() {
        for n in 0..100_000u32 {
            let node = |k: u32| mix(3 * n + k) as i32 >> 5;
            let (nodes, t) = ([node(0), node(1), node(2)], (mix(n) >> 19) as i32);
            let (low, high) = (nodes[0].min(nodes[1]).min(nodes[2]), nodes[0].max(nodes[1]).max(nodes[2]));
            let got = height(nodes, t);
            assert!((low - 2..=high).contains(&got), "{got} of {nodes:?} at {t}");
            let x = f64::from(t) / 8192.0;
            let [a, b, c] = nodes.map(f64::from);
            let exact = (1.0 - x).powi(2) / 2.0 * a + (0.5 + x * (1.0 - x)) * b + x * x / 2.0 * c;
            assert!((f64::from(got) - exact).abs() < 3.0);
            let shares = nodes.map(|node| (node & 0x7fff).abs());
            let share = share(shares, weights(t));
            let exact = (1.0 - x).powi(2) / 2.0 * f64::from(shares[0])
                + (0.5 + x * (1.0 - x)) * f64::from(shares[1])
                + x * x / 2.0 * f64::from(shares[2]);
            assert!((f64::from(share) - exact).abs() < 2.5 && share < 1 << 15);
        }
    }

    #[test]
    fn cells_meet_with_equal_values_and_weights_add_up_to_one() {
        for t in 0..1 << CELL_BITS {
            let weights = weights(t);
            assert_eq!(weights.iter().sum::<i32>(), 1 << 15);
            assert!(weights.iter().all(|weight| i16::try_from(*weight).is_ok()));
        }
        for n in 0..1_000u32 {
            let node = |k: u32| mix(4 * n + k) as i32 >> 5;
            let [a, b, c, d] = [node(0), node(1), node(2), node(3)];
            let (last, first) = (height([a, b, c], (1 << CELL_BITS) - 1), height([b, c, d], 0));
            // One step of the fraction.
            assert!((last - first).abs() <= (c - b).abs() / 8192 + 4);
        }
    }

    #[test]
    fn a_node_lies_in_the_middle_of_its_cell() {
        for p in [-8193, -8192, -1, 0, 8191, 8192, 1 << 30] {
            let (index, t) = cell(p);
            assert_eq!((index << CELL_BITS) + t, p);
            assert!((0..1 << CELL_BITS).contains(&t) && node(index) == (index << CELL_BITS) + 4096);
        }
    }
}
