//! The comparisons.

use crate::land;
use crate::libraries::fastnoise2::{self, Level};
use crate::libraries::{OCTAVES, fastnoise_lite, noise, plain};
use crate::report::{Report, Timed};
use crate::rounds::{self, Contender, Corner, Times};
use crate::threads;
use anyhow::{Result, ensure};
use terrain::constants::VERTICES;

/// Side of the large grid, in samples.
const LARGE: usize = 1024;

const NOISE: &str = "noise Fbm<Perlin>";
const AGAIN: &str = "ours avx2, again";
const TWICE: &str = "ours avx2, twice";
const CHUNK: &str = "ours avx2, the whole land, with pyramids";
const PYRAMID: &str = "one pyramid of 65 x 65";
const COPY: &str = "copy of 65 x 65 heights";

/// Runs all comparisons.
///
/// # Errors
/// The machine or a library lacks what a comparison needs, or a contender does not do its work.
pub fn run(rounds: usize) -> Result<Report> {
    land::check_that_corners_are_on_land()?;
    let mut report = Report::new(rounds, fastnoise2::compiler()?);
    chunks(rounds, &mut report)?;
    // A call takes a hundred times as long with the same spread, so fewer rounds suffice.
    large(rounds.div_ceil(4), &mut report)?;
    pyramids(rounds, &mut report)?;
    scaling(rounds.div_ceil(4), &mut report)?;
    Ok(report)
}

/// 65 x 65 samples: all kernels, all libraries, the controls.
fn chunks(rounds: usize, report: &mut Report) -> Result<()> {
    let (avx2, side) = (land::avx2()?, VERTICES);
    let (mine, library) = (land::name(avx2), Level::Avx2.name());
    let mut contenders: Vec<Contender<'_>> =
        land::kernels().map(|kernel| land::noise(land::name(kernel), kernel, side, side)).collect();
    for level in Level::ALL {
        if level.is_available()? {
            contenders.push(fastnoise2::contender(level, side, side)?);
        }
    }
    contenders.push(fastnoise2::as_shipped("FastNoise2 as the crate calls it", side, side)?);
    contenders.push(noise::contender(NOISE, side, side));
    contenders.push(fastnoise_lite::contender("fastnoise-lite Perlin", side, side));
    contenders.push(plain::contender("plain f32 loop", OCTAVES, side, side));
    check_same_noise(&mut contenders)?;
    contenders.push(land::noise(AGAIN, avx2, side, side));
    contenders.push(land::noise_repeated(TWICE, avx2, side, side, 2));
    contenders.push(land::chunk(CHUNK, avx2));

    let times = timed(&mut contenders, rounds, "65 x 65", (side * side) as f64, report)?;
    for kernel in land::kernels() {
        report.figure(
            format!("chunk_{kernel}"),
            format!("65 x 65, time of {} / {library}", land::name(kernel)),
            times.ratio(&land::name(kernel), library),
        );
    }
    if times.names().any(|name| name == Level::Avx512.name()) {
        report.figure(
            "chunk_avx2_of_avx512",
            format!("65 x 65, time of {mine} / {}", Level::Avx512.name()),
            times.ratio(&mine, Level::Avx512.name()),
        );
    }
    report.figure("noise_crate", format!("65 x 65, time of {NOISE} / {mine}"), times.ratio(NOISE, &mine));
    report.figure(
        "shaping_and_pyramids",
        "65 x 65, time of base field, coasts and both pyramids / noise",
        times.spread(|of| (of(CHUNK) - of(&mine)) / of(&mine)),
    );
    report.control(format!("65 x 65, time of {mine} / itself"), times.ratio(AGAIN, &mine), 0.95..=1.05);
    let once = times.ratio(&mine, library).median;
    report.control(
        format!("65 x 65, time of {mine} with twice the work / {library}"),
        times.ratio(TWICE, library),
        once * 1.9..=once * 2.1,
    );
    Ok(())
}

/// 1024 x 1024 samples.
fn large(rounds: usize, report: &mut Report) -> Result<()> {
    let kernels = land::kernels().filter(|kernel| kernel.to_string().starts_with("avx"));
    let mut contenders: Vec<Contender<'_>> =
        kernels.map(|kernel| land::noise(land::name(kernel), kernel, LARGE, LARGE)).collect();
    for level in [Level::Avx2, Level::Avx512] {
        if level.is_available()? {
            contenders.push(fastnoise2::contender(level, LARGE, LARGE)?);
        }
    }
    let times = timed(&mut contenders, rounds, "1024 x 1024", (LARGE * LARGE) as f64, report)?;
    let (mine, library) = (land::name(land::avx2()?), Level::Avx2.name());
    report.figure(
        "large_avx2",
        format!("1024 x 1024, time of {mine} / {library}"),
        times.ratio(&mine, library),
    );
    Ok(())
}

/// One pyramid against a copy of its heights.
fn pyramids(rounds: usize, report: &mut Report) -> Result<()> {
    let mut contenders = vec![land::pyramid(PYRAMID, land::avx2()?)?, land::copy(COPY)?];
    let times = timed(&mut contenders, rounds, "pyramids", (VERTICES * VERTICES) as f64, report)?;
    report.figure("pyramid", format!("time of {PYRAMID} / {COPY}"), times.ratio(PYRAMID, COPY));
    Ok(())
}

/// Two threads against one.
fn scaling(rounds: usize, report: &mut Report) -> Result<()> {
    let scaling = threads::scaling(rounds)?;
    report.figure("two_threads", "chunks per second, 2 threads / 1 thread", scaling.ratio);
    report.chunks_per_second = scaling.per_second;
    report.notes.push(format!(
        "2 threads: {} rounds count, {} in which other programs took a core were run again",
        scaling.rounds, scaling.disturbed
    ));
    Ok(())
}

fn timed(
    contenders: &mut [Contender<'_>],
    rounds: usize,
    group: &'static str,
    samples: f64,
    report: &mut Report,
) -> Result<Times> {
    contenders.iter_mut().try_for_each(Contender::check)?;
    let (times, disturbed) = rounds::run(contenders, rounds);
    if disturbed > 0 {
        let slices = rounds * contenders.len();
        report.notes.push(format!("{group}: {disturbed} of {slices} slices were disturbed despite repeats"));
    }
    for contender in contenders {
        let microseconds = times.microseconds(contender.name());
        report.times.push(Timed { group, name: contender.name().into(), microseconds, samples });
    }
    Ok(times)
}

/// Rejects contenders with another noise: fewer octaves or larger cells would be less work.
///
/// The ratio of roughness at a distance of 1 sample to that at 16 depends on octaves, cells,
/// lacunarity and gain, but not on amplitude.
fn check_same_noise(contenders: &mut [Contender<'_>]) -> Result<()> {
    const TOLERANCE: f64 = 0.12;
    let expected = roughness(&mut contenders[0]);
    let differs = |roughness: f64| (roughness / expected - 1.0).abs() > TOLERANCE;
    for contender in contenders.iter_mut() {
        let roughness = roughness(contender);
        ensure!(
            !differs(roughness),
            "{} makes another noise than ours: roughness {roughness:.3} instead of {expected:.3}",
            contender.name()
        );
    }
    for octaves in [OCTAVES - 1, OCTAVES + 1] {
        let roughness = roughness(&mut plain::contender("control", octaves, VERTICES, VERTICES));
        ensure!(differs(roughness), "{octaves} octaves would pass for {OCTAVES}: roughness {roughness:.3}");
    }
    Ok(())
}

/// Ratio of the mean second difference along x at a distance of 1 sample to that at 16.
fn roughness(contender: &mut Contender<'_>) -> f64 {
    let (mut near, mut far) = (0.0, 0.0);
    for number in 0..64 {
        let samples = contender.output(Corner::of(number));
        for row in samples.chunks_exact(VERTICES) {
            for centre in 16..VERTICES - 16 {
                let bend =
                    |reach: usize| (row[centre - reach] - 2.0 * row[centre] + row[centre + reach]).abs();
                near += bend(1);
                far += bend(16);
            }
        }
    }
    near / far
}
