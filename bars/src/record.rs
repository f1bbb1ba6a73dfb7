//! The JSON form of a [`Bar`].

use crate::{Bar, Figure, Limit};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// The fields of a bar in JSON. `met` is written for people and scripts and ignored on reading: a
/// reader judges the figure itself.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct Record {
    name: String,
    figure: Option<f64>,
    #[serde(default)]
    unit: Cow<'static, str>,
    direction: Direction,
    bar: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    note: Option<String>,
    /// Why there is no figure, where the machine cannot produce one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    not_measured: Option<String>,
    #[serde(default, skip_deserializing)]
    met: bool,
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
enum Direction {
    Under,
    AtMost,
    AtLeast,
    Reported,
}

impl From<Bar> for Record {
    fn from(bar: Bar) -> Self {
        let met = bar.is_met();
        let (direction, limit) = match bar.limit {
            Limit::Under(limit) => (Direction::Under, Some(limit)),
            Limit::AtMost(limit) => (Direction::AtMost, Some(limit)),
            Limit::AtLeast(limit) => (Direction::AtLeast, Some(limit)),
            Limit::Reported => (Direction::Reported, None),
        };
        let (figure, not_measured) = match bar.figure {
            Figure::Measured(figure) => (Some(figure), None),
            Figure::Missing => (None, None),
            Figure::NotMeasured { reason } => (None, Some(reason)),
        };
        Self {
            name: bar.name,
            figure,
            unit: bar.unit,
            direction,
            bar: limit,
            note: bar.note,
            not_measured,
            met,
        }
    }
}

impl TryFrom<Record> for Bar {
    type Error = String;

    fn try_from(record: Record) -> Result<Self, String> {
        let Record { name, figure, unit, direction, bar, note, not_measured, .. } = record;
        let limit = match (direction, bar) {
            (Direction::Reported, _) => Limit::Reported,
            (Direction::Under, Some(limit)) => Limit::Under(limit),
            (Direction::AtMost, Some(limit)) => Limit::AtMost(limit),
            (Direction::AtLeast, Some(limit)) => Limit::AtLeast(limit),
            (direction, None) => return Err(format!("`{name}`: direction {direction:?} needs a bar")),
        };
        let figure = match (figure, not_measured) {
            (figure, None) => figure.into(),
            (None, Some(reason)) => Figure::NotMeasured { reason },
            (Some(_), Some(_)) => return Err(format!("`{name}` has a figure and was not measured")),
        };
        Ok(Self { name, figure, unit, limit, note })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    #[test]
    fn bars_survive_json() {
        for bar in [
            Bar::new("a", 2.5, "ms", Limit::Under(3.0)).with_note("definition"),
            Bar::new("b", 2.5, "", Limit::AtMost(2.0)),
            Bar::new("c", None, "x", Limit::AtLeast(2.0)),
            Bar::new("e", 1.0, "", Limit::Reported),
            Bar::new("f", None, "ms", Limit::AtMost(2.0)).not_measured_if(true, "needs a GPU"),
        ] {
            let text = serde_json::to_string(&bar).unwrap();
            assert_eq!(serde_json::from_str::<Bar>(&text).unwrap(), bar, "{text}");
        }
    }

    #[test]
    fn json_has_figure_direction_bar_and_verdict() {
        let json = serde_json::to_value(Bar::new("a", 2.5, "ms", Limit::AtMost(2.0))).unwrap();
        let expected = json!({
            "name": "a", "figure": 2.5, "unit": "ms", "direction": "at_most", "bar": 2.0, "met": false,
        });
        assert_eq!(json, expected);
        let json = serde_json::to_value(Bar::under("a", None, "", 1.0).not_measured_if(true, "needs a GPU"))
            .unwrap();
        assert_eq!((&json["not_measured"], &json["met"]), (&json!("needs a GPU"), &json!(false)));
        assert_eq!(json["figure"], Value::Null);
    }

    #[test]
    fn a_nan_becomes_a_missing_figure() {
        let json = serde_json::to_string(&Bar::new("a", Figure::Measured(f64::NAN), "", Limit::Reported));
        let bar: Bar = serde_json::from_str(&json.unwrap()).unwrap();
        assert_eq!(bar.figure, Figure::Missing);
    }

    #[test]
    fn a_reader_does_not_trust_met() {
        let forged = r#"{"name":"a","figure":9,"direction":"at_most","bar":1,"met":true}"#;
        assert!(serde_json::from_str::<Bar>(forged).unwrap().is_missed());
    }

    #[test]
    fn records_that_make_no_sense_are_errors() {
        for wrong in [
            r#"{"name":"a","figure":1,"direction":"at_most","bar":null}"#,
            r#"{"name":"a","figure":1,"direction":"sideways","bar":1}"#,
            r#"{"name":"a","figure":1,"direction":"at_most","bar":1,"not_measured":"needs a GPU"}"#,
            r#"{"figure":1,"direction":"at_most","bar":1}"#,
        ] {
            assert!(serde_json::from_str::<Bar>(wrong).is_err(), "{wrong}");
        }
    }
}
