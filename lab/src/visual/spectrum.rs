//! Power spectrum of the luminance of the ground below the eye, against that of photographs.
//!
//! Photographs of natural scenes have amplitudes that fall as a power of the frequency. The mean
//! exponent over 135 of them is -1.2, single ones range from -0.8 to -1.5 (Tolhurst, Tadmor and
//! Chao, "Amplitude spectra of natural images", Ophthalmic and Physiological Optics 12(2), 1992).

use super::views::{DrawOptions, SIZE, Views};
use crate::lod::screen::ViewCase;
use crate::sample::{self, unit, word};
use client::camera::Pose;
use client::gpu::GpuError;
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::TAU;
use terrain::constants::UNITS_PER_METRE;
use terrain::{Land, Position};

/// Exponent of the power of photographs: twice that of their amplitude.
const EXPONENT: f64 = -2.4;

/// Heights of the eye over the ground, metres.
const HEIGHTS_M: [f64; 3] = [10.0, 100.0, 1_000.0];

/// Side of the square in the middle of a picture, pixels.
const SIDE: usize = 256;

/// Octaves of wavelengths from 2 to 64 pixels.
const OCTAVES: usize = 5;

/// Side of the box that blurs the control, pixels.
const BLUR: usize = 5;

/// Stream of the places, and places that are tried for one on land.
const STREAM: u32 = 61;
const CANDIDATES_PER_PLACE: u32 = 8;

/// A spectrum against that of photographs.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Fit {
    /// Exponent of the power.
    pub exponent: f64,
    /// Largest factor between the power of an octave and [`EXPONENT`] with the best scale.
    pub factor: f64,
}

/// The spectra: geometric means over the places.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Spectrum {
    /// Places.
    pub places: usize,
    /// From 10 m.
    pub near: Fit,
    /// From 100 m.
    pub middle: Fit,
    /// From 1,000 m.
    pub far: Fit,
    /// The pictures from 100 m, blurred: a control.
    pub blurred: Fit,
    /// White noise: a control.
    pub white: Fit,
}

/// Measures so many places.
pub fn measure(views: &mut Views, land: &Land, count: u32) -> Result<Spectrum, GpuError> {
    let places = places(land, count);
    let mut means = [[0.0; OCTAVES]; HEIGHTS_M.len()];
    let mut blurred = [0.0; OCTAVES];
    for (east_m, ground_m, south_m) in &places {
        for (height_m, mean) in HEIGHTS_M.iter().zip(&mut means) {
            let position_m = [*east_m, ground_m + height_m, *south_m].into();
            let pose = Pose { position_m, yaw_deg: 0.0, pitch_deg: -90.0 }.clamped();
            let light = views.light(&ViewCase { pose, tolerance_px: 2.0 }, DrawOptions::IMAGE)?;
            let luminance = middle_of(&light);
            add(mean, octaves(&luminance), places.len());
            if *height_m == HEIGHTS_M[1] {
                add(&mut blurred, octaves(&blur(&luminance)), places.len());
            }
        }
    }
    let [near, middle, far] = means.map(fit);
    let places = places.len();
    Ok(Spectrum { places, near, middle, far, blurred: fit(blurred), white: fit(octaves(&white())) })
}

/// Seeded places on dry land: east, height of the ground and south, metres.
fn places(land: &Land, count: u32) -> Vec<(f64, f64, f64)> {
    let metres = |units: i32| f64::from(units) / f64::from(UNITS_PER_METRE);
    sample::land_points(land.world_seed(), CANDIDATES_PER_PLACE * count, STREAM)
        .filter_map(|(x, z)| {
            let ground_m = metres(land.height_at(Position::new(x, z).ok()?));
            (ground_m > 5.0).then_some((metres(x), ground_m, metres(z)))
        })
        .take(count as usize)
        .collect()
}

/// Luminance of the middle square of a picture (BT.709), over its mean.
fn middle_of(light: &[[f32; 4]]) -> Vec<f64> {
    let [left, top] = [SIZE.0, SIZE.1].map(|side| (side as usize - SIDE) / 2);
    let at = |row: usize, column: usize| {
        let [red, green, blue, _] = light[(top + row) * SIZE.0 as usize + left + column];
        0.2126 * f64::from(red) + 0.7152 * f64::from(green) + 0.0722 * f64::from(blue)
    };
    let values: Vec<f64> = (0..SIDE * SIDE).map(|pixel| at(pixel / SIDE, pixel % SIDE)).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.into_iter().map(|value| value / mean.max(1e-9)).collect()
}

/// Logarithms to base 2 of the mean power in octaves of wavelengths: 2 to 4 pixels, then longer
/// ones. `values` are a square of [`SIDE`], row by row.
fn octaves(values: &[f64]) -> [f64; OCTAVES] {
    // Hann window, against leakage at the borders.
    let window = |at: usize| 0.5 - 0.5 * (TAU * (at as f64 + 0.5) / SIDE as f64).cos();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let field: Vec<[f64; 2]> = values
        .iter()
        .enumerate()
        .map(|(pixel, value)| [(value - mean) * window(pixel / SIDE) * window(pixel % SIDE), 0.0])
        .collect();
    let field = dft_rows(&dft_rows(&field, 1.0), 1.0);
    let mut sums = [(0.0, 0_usize); OCTAVES];
    for (pixel, value) in field.iter().enumerate() {
        let frequency = [pixel / SIDE, pixel % SIDE].map(|at| at.min(SIDE - at) as f64);
        let wavelength = SIDE as f64 / frequency[0].hypot(frequency[1]).max(1.0);
        if (2.0..64.0).contains(&wavelength) {
            let sum = &mut sums[(wavelength.log2() as usize).clamp(1, OCTAVES) - 1];
            *sum = (sum.0 + value[0] * value[0] + value[1] * value[1], sum.1 + 1);
        }
    }
    sums.map(|(sum, count)| (sum / count as f64).max(f64::MIN_POSITIVE).log2())
}

/// Discrete Fourier transform of the rows of a square of complex numbers, transposed: two of them
/// transform the square. By its definition: the squares are small and few. `direction`: 1 forward,
/// -1 back.
fn dft_rows(field: &[[f64; 2]], direction: f64) -> Vec<[f64; 2]> {
    let twiddles: Vec<[f64; 2]> = (0..SIDE)
        .map(|at| (direction * TAU * at as f64 / SIDE as f64).sin_cos())
        .map(|(sine, cosine)| [cosine, -sine])
        .collect();
    (0..SIDE)
        .into_par_iter()
        .flat_map_iter(|frequency| {
            let twiddles = &twiddles;
            field.chunks_exact(SIDE).map(move |row| {
                row.iter().enumerate().fold([0.0, 0.0], |[real, imaginary], (at, [a, b])| {
                    let [c, d] = twiddles[frequency * at % SIDE];
                    [real + a * c - b * d, imaginary + a * d + b * c]
                })
            })
        })
        .collect()
}

fn add(mean: &mut [f64; OCTAVES], one: [f64; OCTAVES], count: usize) {
    mean.iter_mut().zip(one).for_each(|(mean, one)| *mean += one / count as f64);
}

/// The logarithms of an octave each against those of photographs.
fn fit(octaves: [f64; OCTAVES]) -> Fit {
    // From octave to octave the frequency halves.
    let middle = (OCTAVES - 1) as f64 / 2.0;
    let steps = octaves.iter().enumerate().map(|(octave, power)| (middle - octave as f64, *power));
    let (rise, run) =
        steps.clone().fold((0.0, 0.0), |(rise, run), (at, power)| (rise + at * power, run + at * at));
    let residuals: Vec<f64> = steps.map(|(at, power)| power - EXPONENT * at).collect();
    let (least, most) = residuals
        .iter()
        .fold((f64::MAX, f64::MIN), |(least, most), residual| (least.min(*residual), most.max(*residual)));
    Fit { exponent: rise / run, factor: (0.5 * (most - least)).exp2() }
}

/// Means of boxes around each pixel.
fn blur(values: &[f64]) -> Vec<f64> {
    let half = BLUR / 2;
    let mean = |at: [usize; 2]| {
        let [rows, columns] = at.map(|at| at.saturating_sub(half)..(at + half + 1).min(SIDE));
        let count = (rows.len() * columns.len()) as f64;
        rows.flat_map(|row| columns.clone().map(move |column| row * SIDE + column))
            .map(|pixel| values[pixel])
            .sum::<f64>()
            / count
    };
    (0..SIDE * SIDE).map(|pixel| mean([pixel / SIDE, pixel % SIDE])).collect()
}

/// Noise without correlation.
fn white() -> Vec<f64> {
    (0..(SIDE * SIDE) as u32).map(|pixel| unit(word(STREAM, pixel))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A field whose power falls with an exponent: noise, filtered by its transform.
    fn fractal(exponent: f64) -> Vec<f64> {
        let field: Vec<[f64; 2]> = white().into_iter().map(|value| [value - 0.5, 0.0]).collect();
        let mut field = dft_rows(&dft_rows(&field, 1.0), 1.0);
        for (pixel, value) in field.iter_mut().enumerate() {
            let frequency = [pixel / SIDE, pixel % SIDE].map(|at| at.min(SIDE - at) as f64);
            let gain = frequency[0].hypot(frequency[1]).max(1.0).powf(0.5 * exponent);
            *value = value.map(|part| part * gain);
        }
        dft_rows(&dft_rows(&field, -1.0), -1.0).into_iter().map(|[real, _]| real).collect()
    }

    #[test]
    fn fields_with_the_power_of_photographs_fit_and_others_do_not() {
        let good = fit(octaves(&fractal(EXPONENT)));
        assert!((good.exponent - EXPONENT).abs() < 0.15 && good.factor < 1.3, "{good:?}");
        for other in [0.0, -1.2, -3.8] {
            let found = fit(octaves(&fractal(other)));
            assert!((found.exponent - other).abs() < 0.3 && found.factor > 2.0, "{other}: {found:?}");
        }
        let blurred = fit(octaves(&blur(&fractal(EXPONENT))));
        assert!(blurred.factor > 2.0, "{blurred:?}");
        assert!(fit(octaves(&white())).factor > 2.0);
    }
}
