//! Checks that count violations of a bound, with the worst and the first.

use serde::Serialize;
use std::fmt::Display;

/// One property, tested many times.
#[derive(Clone, Debug, Serialize)]
pub struct Check {
    pub name: String,
    pub cases: u64,
    /// Cases that violate it.
    pub violations: u64,
    /// Largest ratio of what was seen to what is allowed; where nothing is allowed, the largest
    /// value seen.
    pub worst: f64,
    pub worst_at: String,
    /// The first violation, in words.
    pub first: Option<String>,
}

impl Check {
    /// A property without tests.
    pub fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), cases: 0, violations: 0, worst: 0.0, worst_at: String::new(), first: None }
    }

    /// Tests one case: `value` must not exceed `allowed` (both at least 0, same unit).
    pub fn expect_within(&mut self, value: f64, allowed: f64, place: impl Display) {
        self.cases += 1;
        let ratio = if allowed > 0.0 { value / allowed } else { value };
        // A value that is not a number violates every property.
        let broken = value.is_nan() || value > allowed;
        if ratio > self.worst || ratio.is_nan() {
            (self.worst, self.worst_at) = (ratio, place.to_string());
        }
        if broken {
            self.violations += 1;
            self.first.get_or_insert_with(|| format!("{value:.3} at {place}, allowed {allowed:.3}"));
        }
    }

    /// Tries once: the two must be equal.
    pub fn expect_equal(&mut self, got: i64, expected: i64, place: impl Display) {
        self.expect_within(got.abs_diff(expected) as f64, 0.0, place);
    }

    /// Whether the property was tested and holds.
    pub fn holds(&self) -> bool {
        self.cases > 0 && self.violations == 0
    }

    /// Adds the cases of another run.
    pub fn merged(mut self, other: Self) -> Self {
        self.cases += other.cases;
        self.violations += other.violations;
        if other.worst > self.worst || other.worst.is_nan() {
            (self.worst, self.worst_at) = (other.worst, other.worst_at);
        }
        self.first = self.first.or(other.first);
        self
    }
}

/// Adds the cases of another run to each.
pub fn merged(all: Vec<Check>, one: Vec<Check>) -> Vec<Check> {
    all.into_iter().zip(one).map(|(all, one)| all.merged(one)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_check_counts_and_remembers_and_an_untried_one_does_not_hold() {
        let mut check = Check::new("property");
        assert!(!check.holds());
        check.expect_within(1.0, 2.0, "here");
        assert!(check.holds() && check.worst == 0.5);
        check.expect_within(3.0, 2.0, "there");
        check.expect_within(f64::NAN, 2.0, "nowhere");
        assert_eq!((check.cases, check.violations), (3, 2));
        assert!(!check.holds() && check.first.clone().unwrap().contains("there"));
        let merged = Check::new("property").merged(check);
        assert_eq!((merged.cases, merged.violations), (3, 2));
    }
}
