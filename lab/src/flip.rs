//! FLIP: the difference between two pictures as seen when they alternate in place, 0 (none) to 1
//! (greatest) for each pixel.
//!
//! After Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and Fairchild, "FLIP: A Difference
//! Evaluator for Alternating Images", Proceedings of the ACM on Computer Graphics and Interactive
//! Techniques 3(2) (HPG), 2020; numbers and section names are theirs. Low dynamic range only.

use client::gpu::Image;
use rayon::prelude::*;

/// Pixels per degree of sight that the authors assume: a 0.7 m wide 4K display seen from 0.7 m.
pub const PIXELS_PER_DEGREE: f64 = 67.0;

type Rgb = [f64; 3];

/// A picture of triples, row by row.
struct Field {
    width: usize,
    height: usize,
    values: Vec<Rgb>,
}

/// FLIP of every pixel, row by row from the top.
///
/// # Panics
/// If the pictures differ in size.
pub fn map(reference: &Image, test: &Image, pixels_per_degree: f64) -> Vec<f64> {
    assert_eq!((reference.width, reference.height), (test.width, test.height), "pictures of one size");
    let [reference, test] = [reference, test].map(opponent);
    let colours = [&reference, &test].map(|field| perceived(field, pixels_per_degree));
    let features = [&reference, &test].map(|field| edges_and_points(field, pixels_per_degree));
    let greatest = greatest_colour_difference();
    colours[0]
        .iter()
        .zip(&colours[1])
        .zip(features[0].iter().zip(&features[1]))
        .map(|((one, other), (its, others))| {
            let colour = redistributed(hyab(*one, *other).powf(COLOUR_EXPONENT), greatest);
            let edges = (its.0 - others.0).abs();
            let points = (its.1 - others.1).abs();
            let feature = (edges.max(points) * std::f64::consts::FRAC_1_SQRT_2).powf(FEATURE_EXPONENT);
            colour.powf(1.0 - feature.min(1.0))
        })
        .collect()
}

/// Mean FLIP of two pictures: what the authors advise as the single number.
///
/// # Panics
/// If the pictures differ in size.
pub fn mean(reference: &Image, test: &Image, pixels_per_degree: f64) -> f64 {
    let map = map(reference, test, pixels_per_degree);
    map.iter().sum::<f64>() / map.len().max(1) as f64
}

const COLOUR_EXPONENT: f64 = 0.7;
const FEATURE_EXPONENT: f64 = 0.5;
/// Differences below this share of the greatest are spread over [`PERCEIVED_SHARE`] of the scale.
const LOW_SHARE: f64 = 0.4;
const PERCEIVED_SHARE: f64 = 0.95;
/// Width of the detectors for edges and points, degrees.
const FEATURE_WIDTH_DEG: f64 = 0.082;

/// Contrast sensitivity as sums of Gaussians, one row per opponent channel: a1, b1, a2, b2; b in
/// square degrees.
const SENSITIVITY: [[f64; 4]; 3] =
    [[1.0, 0.0047, 0.0, 1e-5], [1.0, 0.0053, 0.0, 1e-5], [34.1, 0.04, 13.5, 0.025]];

/// Linear sRGB to CIE XYZ, D65.
const XYZ: [Rgb; 3] = [
    [0.412_390_8, 0.357_584_3, 0.180_480_8],
    [0.212_639_0, 0.715_168_7, 0.072_192_3],
    [0.019_330_8, 0.119_194_8, 0.950_532_2],
];

/// Its inverse.
const FROM_XYZ: [Rgb; 3] = [
    [3.240_969_9, -1.537_383_2, -0.498_610_8],
    [-0.969_243_6, 1.875_967_5, 0.041_555_1],
    [0.055_630_1, -0.203_977_0, 1.056_971_5],
];

fn times(matrix: &[Rgb; 3], vector: Rgb) -> Rgb {
    matrix.map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum())
}

/// XYZ over that of white.
fn relative_xyz(linear: Rgb) -> Rgb {
    let (xyz, white) = (times(&XYZ, linear), times(&XYZ, [1.0; 3]));
    [0, 1, 2].map(|axis| xyz[axis] / white[axis])
}

fn decoded(byte: u8) -> f64 {
    let value = f64::from(byte) / 255.0;
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// The picture in the linear opponent space YCxCz.
fn opponent(picture: &Image) -> Field {
    let values = picture
        .rgba
        .chunks_exact(4)
        .map(|pixel| {
            let [x, y, z] = relative_xyz([0, 1, 2].map(|channel| decoded(pixel[channel])));
            [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
        })
        .collect();
    Field { width: picture.width as usize, height: picture.height as usize, values }
}

/// The picture as perceived: filtered by the contrast sensitivity of the eye, in CIELAB with Hunt's
/// adjustment.
fn perceived(field: &Field, pixels_per_degree: f64) -> Vec<Rgb> {
    let widest = SENSITIVITY.iter().flatten().skip(1).step_by(2).copied().fold(0.0, f64::max);
    let radius =
        (3.0 * (widest / (2.0 * std::f64::consts::PI.powi(2))).sqrt() * pixels_per_degree).ceil() as usize;
    let channels: Vec<Vec<f64>> = (0..3)
        .into_par_iter()
        .map(|channel| {
            let [a1, b1, a2, b2] = SENSITIVITY[channel];
            let source: Vec<f64> = field.values.iter().map(|value| value[channel]).collect();
            let mut sum = vec![0.0; source.len()];
            let mut total = 0.0;
            for (a, b) in [(a1, b1), (a2, b2)] {
                if a == 0.0 {
                    continue;
                }
                let weight = a * (std::f64::consts::PI / b).sqrt();
                let kernel = kernel(radius, |offset| {
                    let degrees = offset / pixels_per_degree;
                    (-(std::f64::consts::PI * degrees).powi(2) / b).exp()
                });
                total += weight * kernel.iter().sum::<f64>().powi(2);
                let smooth = convolved(&source, (field.width, field.height), &kernel, &kernel);
                sum.iter_mut().zip(smooth).for_each(|(sum, value)| *sum += weight * value);
            }
            sum.iter_mut().for_each(|value| *value /= total);
            sum
        })
        .collect();
    (0..field.values.len())
        .map(|index| {
            let [l, cx, cz] = [0, 1, 2].map(|channel| channels[channel][index]);
            let y = (l + 16.0) / 116.0;
            let white = times(&XYZ, [1.0; 3]);
            let xyz = [(y + cx / 500.0) * white[0], y * white[1], (y - cz / 200.0) * white[2]];
            hunt(lab(times(&FROM_XYZ, xyz).map(|value| value.clamp(0.0, 1.0))))
        })
        .collect()
}

fn lab(linear: Rgb) -> Rgb {
    let delta: f64 = 6.0 / 29.0;
    let [x, y, z] = relative_xyz(linear).map(|value| {
        if value > delta.powi(3) { value.cbrt() } else { value / (3.0 * delta * delta) + 4.0 / 29.0 }
    });
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Colours look stronger where it is brighter.
fn hunt([l, a, b]: Rgb) -> Rgb {
    [l, 0.01 * l * a, 0.01 * l * b]
}

/// Distance of large colour differences (Abasi, Amani Tehran and Fairchild, 2020).
fn hyab(one: Rgb, other: Rgb) -> f64 {
    (one[0] - other[0]).abs() + (one[1] - other[1]).hypot(one[2] - other[2])
}

/// The greatest difference that the scale knows: green against blue.
fn greatest_colour_difference() -> f64 {
    hyab(hunt(lab([0.0, 1.0, 0.0])), hunt(lab([0.0, 0.0, 1.0]))).powf(COLOUR_EXPONENT)
}

fn redistributed(difference: f64, greatest: f64) -> f64 {
    let low = LOW_SHARE * greatest;
    if difference < low {
        return difference * PERCEIVED_SHARE / low;
    }
    PERCEIVED_SHARE + (difference - low) / (greatest - low) * (1.0 - PERCEIVED_SHARE)
}

/// Strength of edges and of points at each pixel of the achromatic channel.
fn edges_and_points(field: &Field, pixels_per_degree: f64) -> Vec<(f64, f64)> {
    let luminance: Vec<f64> = field.values.iter().map(|value| (value[0] + 16.0) / 116.0).collect();
    let deviation = 0.5 * FEATURE_WIDTH_DEG * pixels_per_degree;
    let radius = (3.0 * deviation).ceil() as usize;
    let bell = |offset: f64| (-offset * offset / (2.0 * deviation * deviation)).exp();
    let plain = kernel(radius, bell);
    let sum: f64 = plain.iter().sum();
    let plain: Vec<f64> = plain.iter().map(|value| value / sum).collect();
    let first = balanced(kernel(radius, |offset| -offset * bell(offset)));
    let second =
        balanced(kernel(radius, |offset| (offset * offset / (deviation * deviation) - 1.0) * bell(offset)));
    let size = (field.width, field.height);
    let strength = |detector: &[f64]| -> Vec<f64> {
        let across = convolved(&luminance, size, detector, &plain);
        let down = convolved(&luminance, size, &plain, detector);
        across.iter().zip(down).map(|(across, down)| across.hypot(down)).collect()
    };
    strength(&first).into_iter().zip(strength(&second)).collect()
}

/// A detector whose positive weights add up to 1 and whose negative ones to -1.
fn balanced(kernel: Vec<f64>) -> Vec<f64> {
    let sum = |sign: f64| kernel.iter().filter(|value| **value * sign > 0.0).sum::<f64>().abs();
    let (positive, negative) = (sum(1.0), sum(-1.0));
    kernel.into_iter().map(|value| value / if value > 0.0 { positive } else { negative }).collect()
}

fn kernel(radius: usize, weight: impl Fn(f64) -> f64) -> Vec<f64> {
    (0..=2 * radius).map(|index| weight(index as f64 - radius as f64)).collect()
}

/// Across and down with two kernels of odd length; beyond its border a picture goes on as it ends.
fn convolved(source: &[f64], (width, height): (usize, usize), across: &[f64], down: &[f64]) -> Vec<f64> {
    let place = |at: usize, offset: usize, radius: usize, end: usize| {
        (at + offset).saturating_sub(radius).min(end - 1)
    };
    let radius = across.len() / 2;
    let rows: Vec<f64> = source
        .chunks_exact(width)
        .flat_map(|row| {
            (0..width).map(move |x| {
                across
                    .iter()
                    .enumerate()
                    .map(|(o, weight)| weight * row[place(x, o, radius, width)])
                    .sum::<f64>()
            })
        })
        .collect();
    let radius = down.len() / 2;
    (0..width * height)
        .map(|index| {
            let (x, y) = (index % width, index / width);
            down.iter()
                .enumerate()
                .map(|(o, weight)| weight * rows[place(y, o, radius, height) * width + x])
                .sum()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(colour: impl Fn(u32, u32) -> [u8; 3]) -> Image {
        let (width, height) = (48, 32);
        let rgba = (0..width * height)
            .flat_map(|index| {
                let [r, g, b] = colour(index % width, index / width);
                [r, g, b, 255]
            })
            .collect();
        Image { width, height, rgba }
    }

    #[test]
    fn the_difference_of_pictures_is_symmetric_and_0_for_itself() {
        let one = picture(|x, y| [(x * 5) as u8, (y * 7) as u8, 90]);
        let other = picture(|x, y| [(x * 5) as u8, (y * 5) as u8, if x == 20 { 255 } else { 60 }]);
        assert_eq!(mean(&one, &one, PIXELS_PER_DEGREE), 0.0);
        let (there, back) = (mean(&one, &other, PIXELS_PER_DEGREE), mean(&other, &one, PIXELS_PER_DEGREE));
        assert!(there > 0.05 && (there - back).abs() < 1e-12, "{there} {back}");
        assert!(map(&one, &other, PIXELS_PER_DEGREE).iter().all(|value| (0.0..=1.0).contains(value)));
    }

    #[test]
    fn differences_of_known_colours_are_those_of_the_paper() {
        let plain = |colour: [u8; 3]| picture(move |_, _| colour);
        // HyAB of black and white is 100, so by the paper's own steps 100^0.7 = 25.12 of 41.28:
        // 0.967.
        let contrast = mean(&plain([0; 3]), &plain([255; 3]), PIXELS_PER_DEGREE);
        assert!((contrast - 0.967).abs() < 0.002, "{contrast}");
        let greatest = mean(&plain([0, 255, 0]), &plain([0, 0, 255]), PIXELS_PER_DEGREE);
        assert!((greatest - 1.0).abs() < 1e-3, "{greatest}");
        assert!((greatest_colour_difference() - 41.28).abs() < 0.05, "{}", greatest_colour_difference());
    }

    #[test]
    fn a_sharp_line_differs_more_than_the_same_light_spread_out() {
        let grey = picture(|_, _| [128; 3]);
        let line = picture(|x, _| if x == 24 { [255; 3] } else { [128; 3] });
        let veil = picture(|_, _| [131; 3]);
        let [line, veil] =
            [line, veil].map(|test| map(&grey, &test, PIXELS_PER_DEGREE).into_iter().fold(0.0, f64::max));
        assert!(line > 3.0 * veil, "{line} {veil}");
    }

    #[test]
    fn a_distant_eye_sees_less_of_a_fine_pattern() {
        let grey = picture(|_, _| [128; 3]);
        let board = picture(|x, y| if (x + y) % 2 == 0 { [118; 3] } else { [138; 3] });
        let [near, far] = [15.0, 120.0].map(|ppd| mean(&grey, &board, ppd));
        assert!(near > 2.0 * far, "{near} {far}");
    }
}
