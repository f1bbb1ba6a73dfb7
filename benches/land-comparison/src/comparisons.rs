//! The comparisons and their bars.

use crate::agreement::{Agreement, TOLERANCE_M};
use crate::contenders::{float_heights, float_whole, ours, version_3};
use crate::floats::{Ours, Short};
use crate::rounds::{self, Contender, Times};
use anyhow::Result;
use bars::{Bar, Limit};

const OURS: &str = "ours, heights";
const WHOLE: &str = "ours, whole";
const AGAIN: &str = "ours, whole, again";
const TWICE: &str = "ours, whole, twice";
const VERSION_3: &str = "version 3, heights";
const VERSION_3_WHOLE: &str = "version 3, whole";
const DIRECT: &str = "floats, every octave at every vertex, heights";
const DIRECT_WHOLE: &str = "floats, every octave at every vertex, whole";
const DIRECT_OURS: &str = "floats, every octave at every vertex, our hash, heights";
const SPLINED: &str = "floats, wide octaves splined as ours, heights";
const SPLINED_WHOLE: &str = "floats, wide octaves splined as ours, whole";
const SPLINED_OURS: &str = "floats, wide octaves splined as ours, our hash, heights";

/// Names, so that records find rows by them.
const RATIOS: [(&str, &str, &str, Limit); 9] = [
    ("whole chunk, AVX2: time of version 3's", WHOLE, VERSION_3_WHOLE, Limit::AtMost(2.5)),
    ("heights, AVX2: time of version 3's", OURS, VERSION_3, Limit::Reported),
    ("heights, AVX2: time of floats, every octave at every vertex", OURS, DIRECT, Limit::AtMost(0.35)),
    ("whole chunk, AVX2: time of floats, every octave at every vertex", WHOLE, DIRECT_WHOLE, Limit::Reported),
    ("heights, AVX2: time of floats with our hash, at every vertex", OURS, DIRECT_OURS, Limit::Reported),
    ("heights, AVX2: time of floats, wide octaves splined as ours", OURS, SPLINED, Limit::Reported),
    (
        "whole chunk, AVX2: time of floats, wide octaves splined as ours",
        WHOLE,
        SPLINED_WHOLE,
        Limit::Reported,
    ),
    ("heights, AVX2: time of floats with our hash, splined as ours", OURS, SPLINED_OURS, Limit::Reported),
    ("floats, every octave at every vertex: time of splined ones", DIRECT, SPLINED, Limit::Reported),
];

/// Rows and remarks.
pub struct Report {
    /// Every figure beside its bar.
    pub bars: Vec<Bar>,
    /// How they were measured.
    pub notes: Vec<String>,
}

/// Times all contenders.
///
/// # Errors
/// The machine lacks what a contender needs, or a contender does not do its work.
pub fn run(rounds: usize, agreement: &Agreement) -> Result<Report> {
    ours::check_that_corners_are_on_land()?;
    version_3::check_that_corners_are_on_land()?;
    let mut contenders: Vec<Contender<'_>> = vec![
        ours::heights(OURS)?,
        ours::whole(WHOLE, 1)?,
        version_3::heights(VERSION_3)?,
        version_3::whole(VERSION_3_WHOLE, 1)?,
        float_heights::<Short, false>(DIRECT)?,
        float_whole::<Short, false>(DIRECT_WHOLE)?,
        float_heights::<Ours, false>(DIRECT_OURS)?,
        float_heights::<Short, true>(SPLINED)?,
        float_whole::<Short, true>(SPLINED_WHOLE)?,
        float_heights::<Ours, true>(SPLINED_OURS)?,
        ours::whole(AGAIN, 1)?,
        ours::whole(TWICE, 2)?,
    ];
    contenders.iter_mut().try_for_each(Contender::check)?;
    let (times, disturbed) = rounds::run(&mut contenders, rounds);
    let mut notes = vec![format!(
        "{rounds} interleaved rounds on one thread; {disturbed} of {} slices were disturbed despite repeats.",
        rounds * contenders.len()
    )];
    notes.extend(contenders.iter().map(|contender| {
        let name = contender.name();
        format!("{name}: {:.2} us a chunk.", times.microseconds(name))
    }));
    let mut bars = Vec::new();
    for (what, of, over, limit) in RATIOS {
        let spread = times.ratio(of, over);
        bars.push(Bar::new(what, spread.median, "x", limit));
        notes.push(format!("{what}: {:.3} to {:.3} over the rounds.", spread.min, spread.max));
    }
    bars.extend(controls(&times));
    bars.extend(agreements(agreement));
    Ok(Report { bars, notes })
}

/// Ratios that are known.
fn controls(times: &Times) -> [Bar; 1] {
    let (same, double) = (times.ratio(AGAIN, WHOLE).median, times.ratio(TWICE, WHOLE).median);
    let failed = [(0.95..=1.05).contains(&same), (1.9..=2.1).contains(&double)];
    let failed = failed.iter().filter(|kept| !**kept).count();
    [Bar::none("controls of the timing that failed", Some(failed as f64)).with_note(format!(
        "ours against itself, which must give 1: {same:.3}; ours with twice the work, which must give 2: \
         {double:.3}"
    ))]
}

/// Differences of heights.
fn agreements(agreement: &Agreement) -> [Bar; 4] {
    let within = |what, figure| Bar::at_most(what, Some(figure), "m", TOLERANCE_M);
    let beyond = |what, figure| Bar::at_least(what, Some(figure), "m", 2.0 * TOLERANCE_M);
    [
        within("floats, splined: farthest height from ours", agreement.splined),
        within("floats, at every vertex, six octaves: farthest height from ours", agreement.direct),
        beyond("splined, without the last octave (control)", agreement.splined_control),
        beyond("at every vertex, without the last octave (control)", agreement.direct_control),
    ]
}
