//! Twin of `wgsl/shared/field.wesl`: which clumps are drawn, how wide and how high.

use crate::layout::Field;

/// Mean share of the clumps that are drawn at a distance.
#[must_use]
pub fn field_share(field: &Field, distance_m: f32) -> f32 {
    return f32::min(1.0, field.thin_from_m / distance_m.max(1e-3));
}

/// Ranks over which a clump narrows to 0, as a share of all ranks.
#[must_use]
pub fn field_band(share: f32) -> f32 {
    return (0.25 * share).max(1.0 / 256.0).min(2.0 * (1.0 - share));
}

/// Share of its width that thinning leaves to a clump of `rank` 0 to 255.
#[must_use]
pub fn field_presence(share: f32, rank: u32) -> f32 {
    let band = field_band(share);
    let inside = share + 0.5 * band - (rank as f32 + 0.5) / 256.0;
    return (inside / band.max(1e-6)).clamp(0.0, 1.0);
}

/// Whether a clump is drawn at a distance at all.
#[must_use]
pub fn field_keeps(field: &Field, rank: u32, distance_m: f32) -> bool {
    return distance_m < field.range_m && field_presence(field_share(field, distance_m), rank) > 0.0;
}

/// Factor of the width of a clump.
#[must_use]
pub fn field_widening(field: &Field, rank: u32, distance_m: f32) -> f32 {
    let share = field_share(field, distance_m);
    return (1.0 / share.max(1e-6)).min(field.widest) * field_presence(share, rank);
}

/// Factor of the height of a clump.
#[must_use]
pub fn field_height_scale(field: &Field, distance_m: f32) -> f32 {
    let band_m = field.collapse_m.max(1e-3);
    return 1.0 - smoothstep(field.range_m - band_m, field.range_m, distance_m);
}

/// Width and height of a clump without widening and collapse, metres, from its numbers 0 to 1.
#[must_use]
pub fn field_size_m(field: &Field, width: f32, height: f32) -> [f32; 2] {
    let mix = |low: f32, high: f32, share: f32| low * (1.0 - share) + high * share;
    return [
        mix(field.width_low_m, field.width_high_m, width),
        mix(field.height_low_m, field.height_high_m, height),
    ];
}

/// WGSL's `smoothstep` for `low` below `high`.
fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let share = ((x - low) / (high - low)).clamp(0.0, 1.0);
    return share * share * (3.0 - 2.0 * share);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field() -> Field {
        Field {
            width_low_m: 0.1,
            width_high_m: 0.3,
            height_low_m: 0.2,
            height_high_m: 0.7,
            thin_from_m: 10.0,
            widest: 8.0,
            range_m: 300.0,
            collapse_m: 50.0,
            lod_m: [12.0, 40.0],
            ..bytemuck::Zeroable::zeroed()
        }
    }

    /// Widths of all ranks together at a distance, over that of all of them near by.
    fn cover(field: &Field, distance_m: f32) -> f32 {
        (0..256).map(|rank| field_widening(field, rank, distance_m)).sum::<f32>() / 256.0
    }

    #[test]
    fn number_times_width_is_constant_up_to_the_widest() {
        let field = field();
        for tenth in 1..=800 {
            let distance_m = tenth as f32 / 10.0;
            let found = cover(&field, distance_m);
            assert!((found - 1.0).abs() < 0.01, "{found} at {distance_m} m");
        }
        // Beyond, thinning costs cover: at twice the distance of the widest, half of it.
        assert!((cover(&field, 160.0) - 0.5).abs() < 0.01);
        // The control: the same clumps without widening.
        let plain = Field { widest: 1.0, ..field };
        assert!(cover(&plain, 40.0) < 0.3);
    }

    #[test]
    fn a_clump_drawn_at_a_distance_is_drawn_at_lesser_ones() {
        let field = field();
        for rank in 0..256 {
            let stands: Vec<bool> =
                (0..6000).map(|step| field_keeps(&field, rank, step as f32 / 20.0)).collect();
            assert!(stands[0] && stands.is_sorted_by(|near, far| near >= far), "rank {rank}");
        }
        assert!(!field_keeps(&field, 0, 300.0), "nothing stands beyond the range");
    }

    #[test]
    fn a_clump_narrows_to_zero_before_thinning_removes_it() {
        let field = field();
        for rank in (0..256).step_by(5) {
            let at = |step: u32| field_widening(&field, rank, step as f32 / 200.0);
            let widths: Vec<f32> = (0..30_000).map(at).collect();
            // Half a centimetre between two of them.
            let jump = widths.windows(2).map(|pair| (pair[1] - pair[0]).abs() / pair[0].max(1.0));
            assert!(jump.fold(0.0, f32::max) < 0.5, "rank {rank}");
            let last = widths.iter().rposition(|width| *width > 0.0).unwrap();
            assert!(rank < 20 || (last < 29_999 && widths[last] < 0.1), "rank {rank}");
        }
        // The control: without the band a whole width goes at once.
        assert!(field_share(&field, 20.0) == 0.5 && field_presence(0.5, 127) == 0.515_625);
    }

    #[test]
    fn heights_collapse_in_the_last_band_only() {
        let field = field();
        assert_eq!([0.0, 100.0, 250.0].map(|d| field_height_scale(&field, d)), [1.0; 3]);
        assert_eq!([300.0, 400.0].map(|d| field_height_scale(&field, d)), [0.0; 2]);
        assert!((field_height_scale(&field, 275.0) - 0.5).abs() < 1e-5);
        let sharp = Field { collapse_m: 0.0, ..field };
        assert_eq!([299.9, 300.0].map(|d| field_height_scale(&sharp, d)), [1.0, 0.0], "no band is a step");
        assert_eq!(field_size_m(&field, 0.0, 1.0), [0.1, 0.7]);
    }
}
