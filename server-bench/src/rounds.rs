//! Statistics: figures of rounds, quantiles, fairness.

use bars::figures::median;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::time::Duration;

/// The figures of several rounds by name.
#[derive(Clone, Debug, Default)]
pub struct Rounds(BTreeMap<&'static str, Figures>);

/// A figure of each round.
#[derive(Clone, Debug, Default)]
struct Figures {
    rounds: Vec<Option<f64>>,
    /// Whether the largest one stands for all: a median would outvote the round that it is of.
    is_extreme: bool,
}

impl Figures {
    /// The median, or the largest; none if a round lacks the figure.
    fn all(&self) -> Option<f64> {
        let largest = || self.rounds.iter().copied().reduce(|one, other| Some(one?.max(other?))).flatten();
        if self.is_extreme { largest() } else { median(self.rounds.iter().copied()) }
    }
}

impl Rounds {
    /// Adds a round's figure, whose median counts.
    pub fn push(&mut self, name: &'static str, figure: impl Into<Option<f64>>) {
        self.0.entry(name).or_default().rounds.push(figure.into());
    }

    /// Adds a round's figure, of which the largest of all rounds counts: what must happen in none.
    pub fn push_extreme(&mut self, name: &'static str, figure: impl Into<Option<f64>>) {
        let figures = self.0.entry(name).or_default();
        figures.is_extreme = true;
        figures.rounds.push(figure.into());
    }

    /// Adds to an object each figure as the median or the largest of the rounds, and all rounds as
    /// `NAME_rounds`. A figure that a round lacks has neither.
    pub fn add_to(self, mut object: Value) -> Value {
        let fields = object.as_object_mut().map(std::mem::take).unwrap_or_default();
        let all = self.0.iter().map(|(name, figures)| ((*name).into(), json!(figures.all())));
        let rounds = self.0.iter().map(|(name, figures)| (format!("{name}_rounds"), json!(figures.rounds)));
        Value::Object(fields.into_iter().chain(all).chain(rounds).collect::<Map<_, _>>())
    }
}

/// The nearest-rank quantile `q` (0 to 1) of durations, milliseconds; none if there are no values.
pub fn quantile_ms(mut values: Vec<Duration>, q: f64) -> Option<f64> {
    values.sort_unstable();
    bars::stats::quantile(&values, q).map(ms)
}

/// Jain's fairness index: 1 if all shares are equal, 1/n if one client has everything (Jain, Chiu
/// and Hawe, DEC TR-301, 1984).
pub fn jain(shares: &[f64]) -> f64 {
    let (sum, squares) =
        shares.iter().fold((0.0, 0.0), |(sum, squares), share| (sum + share, squares + share * share));
    sum * sum / (shares.len() as f64 * squares)
}

/// Milliseconds of a duration.
pub fn ms(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_is_the_median_of_its_rounds_and_none_if_a_round_lacks_it() {
        let mut rounds = Rounds::default();
        for (a, b) in [(3.0, Some(1.0)), (1.0, None), (2.0, Some(1.0))] {
            rounds.push("a", a);
            rounds.push("b", b);
        }
        let expected = json!({
            "clients": 9, "a": 2.0, "a_rounds": [3.0, 1.0, 2.0], "b": null, "b_rounds": [1.0, null, 1.0],
        });
        assert_eq!(rounds.add_to(json!({ "clients": 9 })), expected);
    }

    #[test]
    fn no_round_outvotes_an_extreme() {
        let mut rounds = Rounds::default();
        for (a, b) in [(Some(3.0), Some(1.0)), (Some(9.0), None), (Some(2.0), Some(2.0))] {
            rounds.push_extreme("a", a);
            rounds.push_extreme("b", b);
        }
        let all = rounds.add_to(json!({}));
        assert_eq!((&all["a"], &all["b"]), (&json!(9.0), &json!(null)));
    }

    #[test]
    fn quantiles_are_nearest_ranks() {
        let values: Vec<_> = (1..=100).rev().map(Duration::from_millis).collect();
        let quantiles = [0.0, 0.5, 0.99, 1.0].map(|q| quantile_ms(values.clone(), q));
        assert_eq!(quantiles, [1.0, 50.0, 99.0, 100.0].map(Some));
        assert_eq!(quantile_ms(Vec::new(), 0.5), None);
    }

    #[test]
    fn equal_shares_have_index_1_and_a_monopoly_1_over_n() {
        assert!((jain(&[5.0; 7]) - 1.0).abs() < 1e-12);
        assert!((jain(&[0.0, 0.0, 9.0, 0.0]) - 0.25).abs() < 1e-12);
    }
}
