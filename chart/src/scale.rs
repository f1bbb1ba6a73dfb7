//! Ranges of axes, their ticks and the text of a tick.

use crate::{Panel, Scale};
use anyhow::{Result, anyhow};
use std::ops::Range;

/// Ticks of a logarithmic axis: decades over many of them, else their halves and fifths too.
pub(crate) fn log_ticks(range: &Range<f64>) -> Vec<f64> {
    let (low, high) = (range.start.log10(), range.end.log10());
    let leads: &[f64] = match high - low {
        span if span > 2.5 => &[1.0],
        span if span > 1.0 => &[1.0, 2.0, 5.0],
        _ => &[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0],
    };
    // The ends of a range are computed and may be off by their last bits.
    let within = |value: &f64| (range.start * 0.999_999..=range.end * 1.000_001).contains(value);
    (low.floor() as i32..=high.ceil() as i32)
        .flat_map(|power| leads.iter().map(move |lead| lead * 10f64.powi(power)))
        .filter(within)
        .collect()
}

/// Ranges of both axes of a panel.
///
/// # Errors
/// The panel is empty and has no range of x.
pub(crate) fn ranges(panel: &Panel) -> Result<(Range<f64>, Range<f64>)> {
    let y = range(panel, panel.y.scale, true, |point| point.1)?;
    let y = if panel.is_from_zero && panel.y.scale == Scale::Linear { 0.0..y.end } else { y };
    match &panel.x_range {
        Some(x) => Ok((x.clone(), y)),
        None => Ok((range(panel, panel.x.scale, false, |point| point.0)?, y)),
    }
}

/// The range of an axis: whole decades upwards, else a little air around the values, a little more
/// above them.
fn range(panel: &Panel, scale: Scale, is_up: bool, pick: impl Fn(&(f64, f64)) -> f64) -> Result<Range<f64>> {
    let shown = panel.series.iter().flat_map(|series| &series.points).filter(|point| panel.shows(**point));
    let (low, high) = shown.map(pick).fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    // Names stand to the right of their dots.
    let is_named = panel.series.iter().any(|series| !series.names.is_empty());
    if low > high {
        return match (&panel.x_range, scale) {
            (None, _) => Err(anyhow!("`{}` has nothing to show", panel.title)),
            (Some(_), Scale::Log) => Ok(1.0..10.0),
            (Some(_), Scale::Linear) => Ok(0.0..1.0),
        };
    }
    Ok(match scale {
        Scale::Log if is_up => {
            let (low, high) = ((low.log10() + 1e-6).floor(), (high.log10() - 1e-6).ceil());
            10f64.powf(low)..10f64.powf(high.max(low + 1.0))
        }
        Scale::Log => low / 1.2..high * if is_named { 1.4 } else { 1.2 },
        Scale::Linear => {
            let low = if low >= 0.0 && low < 0.5 * high { low.min(0.0) } else { low - (high - low) * 0.06 };
            let air = if is_up {
                0.08
            } else if is_named {
                0.14
            } else {
                0.04
            };
            low..high + ((high - low) * air).max(1e-9)
        }
    })
}

/// A number on an axis. On a logarithmic one, plain from 0.001 to 10,000 and else by its power of
/// ten, so that neighbours look alike.
pub(crate) fn tick(scale: Scale, value: f64) -> String {
    let magnitude = value.abs();
    // Computed powers of ten are off by their last bits.
    let plain = match scale {
        Scale::Log => 0.000_999..10_001.0,
        Scale::Linear => 1e-4..1e6,
    };
    if magnitude != 0.0 && !plain.contains(&magnitude) {
        let power = (magnitude.log10() + 1e-9).floor();
        let lead = value / 10f64.powf(power);
        let lead = format!("{lead:.1}");
        return format!("{}e{power}", lead.trim_end_matches(".0"));
    }
    let text = format!("{value:.4}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_on_axes_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (1.0, "1"),
            (0.25, "0.25"),
            (0.0001, "0.0001"),
            (1e-6, "1e-6"),
            (4.2e6, "4.2e6"),
            (5e6, "5e6"),
        ] {
            assert_eq!(tick(Scale::Linear, value), text);
        }
        let decades: Vec<String> = (-5..=6).map(|power| tick(Scale::Log, 10f64.powi(power))).collect();
        let texts = ["1e-5", "1e-4", "0.001", "0.01", "0.1", "1", "10", "100", "1000", "10000", "1e5", "1e6"];
        assert_eq!(decades, texts);
    }

    #[test]
    fn a_logarithmic_axis_has_ticks_from_its_first_value_to_its_last() {
        assert_eq!(log_ticks(&(1e-3..1e3)).len(), 7);
        let tight = log_ticks(&(0.2..20.0));
        let expected = [0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0];
        assert_eq!(tight.len(), expected.len(), "{tight:?}");
        assert!(
            tight.iter().zip(expected).all(|(tick, value)| (tick / value - 1.0).abs() < 1e-9),
            "{tight:?}"
        );
        assert_eq!(log_ticks(&(0.9..1.6)), [1.0, 1.5]);
    }
}
