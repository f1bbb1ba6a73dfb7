//! `measure`: the built programs against the project's bars. Figures depend on the machine, so tests never check them; this
//! does, and leaves a dated record.

mod bars;
mod first_voyage;
mod record;

use anyhow::{Result, bail};

/// A measurement by name.
type Measurement = (&'static str, fn() -> Result<()>);

const MEASUREMENTS: [Measurement; 1] = [("first-voyage", first_voyage::run)];

/// Runs one measurement.
///
/// # Errors
/// An unknown name (with those that are known), a measurement that could not run, or a bar that was missed.
pub fn run(name: &str) -> Result<()> {
    match MEASUREMENTS.into_iter().find(|(known, _)| *known == name) {
        Some((_, measurement)) => measurement(),
        None => {
            let known = MEASUREMENTS.map(|(known, _)| known).join(", ");
            bail!("measure: `{name}` is not known; give one of: {known}")
        }
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn an_unknown_name_is_answered_with_the_known_ones() {
        let error = super::run("second-voyage").unwrap_err().to_string();
        assert!(error.contains("second-voyage") && error.contains("first-voyage"), "{error}");
    }
}
