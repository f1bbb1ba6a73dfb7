//! Parsers of option values.

/// A number in a range.
pub(super) fn parse_within(text: &str, low: f64, high: f64) -> Result<f64, String> {
    // A NaN is in no range.
    text.parse()
        .ok()
        .filter(|value| (low..=high).contains(value))
        .ok_or_else(|| format!("expected a number from {low} to {high}"))
}
