//! The bars of the pictures.

use bars::Bar;
use bars::figures::{at, ratio};
use serde_json::Value;

/// Poses; fewer measure nothing.
const POSES: f64 = 60.0;

/// Every figure beside its bar.
pub fn rows(visual: &Value) -> Vec<Bar> {
    let is_whole = at(visual, "poses") >= Some(POSES);
    let figure = |field| at(visual, field).filter(|_| is_whole);
    let black = ratio(figure("shadow/black_at_noon"), figure("shadow/noon_pixels"));
    vec![
        Bar::at_most(
            "light jump across chunk borders, p99.9, over that at their middle lines",
            figure("borders/land/ratio"),
            "x",
            1.05,
        ),
        Bar::at_least(
            "the same by normals of the drawn triangles (control)",
            figure("borders/mesh/ratio"),
            "x",
            1.05,
        ),
        Bar::reported(
            "change of shading from 0.5 to 4 px, mean FLIP of the ground",
            figure("tolerance/land"),
            "",
        ),
        Bar::at_most(
            "over the same by normals of the drawn triangles",
            ratio(figure("tolerance/land"), figure("tolerance/mesh")),
            "x",
            1.0 / 3.0,
        ),
        Bar::reported(
            "change of light from 0.5 to 4 px, mean FLIP of white ground",
            figure("tolerance/land_light"),
            "",
        ),
        Bar::at_most(
            "over the same by normals of the drawn triangles, light",
            ratio(figure("tolerance/land_light"), figure("tolerance/mesh_light")),
            "x",
            1.0 / 3.0,
        ),
        Bar::at_least(
            "luminance in shadow over light, after tone mapping",
            figure("shadow/over_light"),
            "",
            0.25,
        ),
        Bar::at_most("luminance in shadow over light, upper bar", figure("shadow/over_light"), "", 0.45),
        Bar::none("share of ground pixels at noon below sRGB 12", black),
    ]
}

const NOTES: [&str; 3] = [
    "Pictures of 480 x 270, 60 degrees, 8 km, 2 px, no sea and no plants; half of the poses lie on islands \
     all over the world, from eye level to 2 km.",
    "Light jump: light of sun and sky on white ground, linear; pairs of neighbouring pixels whose distances \
     differ by at most 3 %; the larger light less the smaller one over their sum. Middle lines of chunks \
     are no borders and lie at the same distances.",
    "Shadow: sun at 15 degrees; pixels that lose at least 30 % of their luminance by the shadow of the land; \
     mean of a pose, median of poses with at least 200 such pixels. Noon: sun at 60 degrees.",
];

/// How the figures were measured, for the record.
pub fn notes(visual: &Value) -> Vec<String> {
    let pairs = at(visual, "borders/land/pairs").unwrap_or(0.0);
    let poses = at(visual, "shadow/poses").unwrap_or(0.0);
    let counts = format!("{pairs:.0} pairs across borders; {poses:.0} poses with shadow.");
    NOTES.map(str::to_owned).into_iter().chain([counts]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn visual() -> Value {
        json!({
            "poses": 60,
            "borders": { "land": { "ratio": 1.0, "pairs": 9 }, "mesh": { "ratio": 2.0 } },
            "tolerance": { "land": 0.01, "mesh": 0.05, "land_light": 0.01, "mesh_light": 0.04 },
            "shadow": { "poses": 20, "over_light": 0.3, "noon_pixels": 10, "black_at_noon": 0 },
        })
    }

    fn missed(visual: &Value) -> usize {
        rows(visual).iter().filter(|row| row.is_missed()).count()
    }

    #[test]
    fn a_good_report_meets_every_bar_and_an_empty_or_short_one_none() {
        assert_eq!(missed(&visual()), 0);
        assert_eq!(missed(&Value::Null), 9);
        let mut short = visual();
        short["poses"] = json!(59);
        assert_eq!(missed(&short), 9);
    }

    #[test]
    fn each_bar_can_be_missed() {
        for (path, value) in [
            ("/borders/land/ratio", json!(1.06)),
            ("/borders/mesh/ratio", json!(1.04)),
            ("/tolerance/land", json!(0.02)),
            ("/tolerance/land_light", json!(0.02)),
            ("/shadow/over_light", json!(0.2)),
            ("/shadow/over_light", json!(0.5)),
            ("/shadow/black_at_noon", json!(1)),
        ] {
            let mut visual = visual();
            *visual.pointer_mut(path).unwrap() = value;
            assert_eq!(missed(&visual), 1, "{path}");
        }
    }
}
