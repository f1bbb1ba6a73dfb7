//! The bars of the pictures.

use bars::Bar;
use bars::figures::{at, ratio};
use serde_json::Value;

/// Poses; fewer measure nothing.
const POSES: f64 = super::POSES as f64;

/// The least contrast that an eye sees, as a share of the light: about 1 % (Poynton, "Digital Video
/// and HD: Algorithms and Interfaces", 2012, on lightness).
const LEAST_SEEN: f64 = 0.01;

/// Why a figure of software drivers is missing on another driver.
const NEEDS_SOFTWARE: &str = "needs a software driver";

/// Every figure beside its bar.
pub fn rows(visual: &Value) -> Vec<Bar> {
    let is_whole = at(visual, "poses") >= Some(POSES);
    let figure = |field: &str| at(visual, field).filter(|_| is_whole);
    // A figure from too few pictures is missing.
    let enough = |field: &str, least: f64, of: &str| figure(field).filter(|_| at(visual, of) >= Some(least));
    let shadow = |field: &str| enough(field, 20.0, "shadow/poses");
    let impostors = |field: &str| enough(field, 10.0, "impostors/poses");
    let is_software = visual.pointer("/frame_time/is_software") != Some(&Value::Bool(false));
    let timed = |what: &'static str, field: &str, bar: f64| {
        Bar::at_most(what, figure(&format!("frame_time/{field}")), "x", bar)
            .not_measured_if(!is_software, NEEDS_SOFTWARE)
    };
    let black = ratio(figure("shadow/black_at_noon"), figure("shadow/noon_pixels"));
    vec![
        Bar::at_most(
            "light jump across chunk borders, p99.9, over that at their middle lines",
            figure("borders/land/ratio"),
            "x",
            1.05,
        ),
        Bar::at_least(
            "light jump, p99.9, one side of borders three times as bright (control)",
            figure("borders/planted/ratio"),
            "x",
            1.05,
        ),
        Bar::reported("light jump by normals of the drawn triangles", figure("borders/mesh/ratio"), "x"),
        Bar::at_most(
            "light jump, median across borders less that inside, share of the light",
            figure("borders/land/median_excess"),
            "",
            LEAST_SEEN / 2.0,
        ),
        Bar::at_least(
            "light jump, median, one side of borders 2 % brighter (control)",
            figure("borders/planted/median_excess"),
            "",
            LEAST_SEEN / 2.0,
        ),
        Bar::reported(
            "light jump, median, by normals of the drawn triangles",
            figure("borders/mesh/median_excess"),
            "",
        ),
        Bar::reported(
            "light jump, median across borders over that inside",
            figure("borders/land/median_ratio"),
            "x",
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
            "the same ratio where the drawn surface stays in place, to 0.25 px",
            ratio(figure("tolerance/still"), figure("tolerance/mesh_still")),
            "x",
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
            shadow("shadow/over_light"),
            "",
            0.25,
        ),
        Bar::at_most("luminance in shadow over light, upper bar", shadow("shadow/over_light"), "", 0.45),
        Bar::none("share of ground pixels at noon below sRGB 12", black),
        Bar::at_most(
            "power of the ground from 10 m over that of photographs, worst octave of 2 to 64 px",
            figure("spectrum/near/factor"),
            "x",
            2.0,
        ),
        Bar::at_most("the same from 100 m", figure("spectrum/middle/factor"), "x", 2.0),
        Bar::at_most("the same from 1,000 m", figure("spectrum/far/factor"), "x", 2.0),
        Bar::at_least("the same from 100 m, blurred (control)", figure("spectrum/blurred/factor"), "x", 2.0),
        Bar::at_least("the same of white noise (control)", figure("spectrum/white/factor"), "x", 2.0),
        Bar::reported("exponent of the power from 10 m", figure("spectrum/near/exponent"), ""),
        Bar::reported("exponent of the power from 100 m", figure("spectrum/middle/exponent"), ""),
        Bar::reported("exponent of the power from 1,000 m", figure("spectrum/far/exponent"), ""),
        Bar::none("pixels without finite light, of all light that was read", figure("unlit")),
        Bar::none("pixels of land cut by the near plane, lifted eyes", figure("lifted/magenta")),
        Bar::some("by the vertical rule (control)", figure("lifted/magenta_before")),
        Bar::at_most(
            "shadows on the floor of pom and spom: share of wrong pixels",
            ratio(figure("floor/wrong"), figure("floor/pixels")),
            "",
            0.005,
        ),
        Bar::at_least(
            "against a truth moved by 0.3 m (control)",
            ratio(figure("floor/control"), figure("floor/pixels")),
            "",
            0.005,
        ),
        Bar::at_most(
            "tree impostor against geometry, mean FLIP of tree pixels",
            impostors("impostors/flip"),
            "",
            0.05,
        ),
        Bar::reported("the same over the whole picture", figure("impostors/picture"), ""),
        Bar::reported("the same with four samples a pixel", figure("impostors/smooth"), ""),
        Bar::reported("geometry against itself, half a pixel aside", figure("impostors/moved"), ""),
        Bar::reported(
            "light of impostors over that of geometry, pixels of both",
            figure("impostors/luminance"),
            "x",
        ),
        Bar::reported("pixels of impostors over those of geometry", figure("impostors/cover"), "x"),
        Bar::at_least("no tree against geometry (control)", impostors("impostors/without"), "", 0.05),
        Bar::at_most("shadows of trees: share of wrong places", figure("tree_shadow/near"), "", 0.02),
        Bar::at_least("with the sun turned by 5 degrees (control)", figure("tree_shadow/control"), "", 0.02),
        Bar::at_most(
            "600 to 1,100 m away, 1,080 lines: share of wrong places",
            figure("tree_shadow/distant"),
            "",
            0.05,
        ),
        Bar::at_least(
            "with the sun turned by 5 degrees, far (control)",
            figure("tree_shadow/distant_control"),
            "",
            0.05,
        ),
        Bar::at_most("far: share of wrong means of 30 m", figure("tree_shadow/far"), "", 0.05),
        Bar::reported("far: error of the mean of all places", figure("tree_shadow/far_mean"), ""),
        Bar::at_least("far, without shadows (control)", figure("tree_shadow/far_control"), "", 0.05),
        timed("default of software drivers over a bare frame, median", "default_over_bare", 0.5),
        timed("default of software drivers over a bare frame, p99", "default_over_bare_p99", 0.5),
        timed("everything on over the earlier frame with plants, median", "all_over_planted", 2.0),
        timed(
            "everything on over the earlier frame with plants, slowest of 9",
            "all_over_planted_slowest",
            2.0,
        ),
    ]
}

const NOTES: [&str; 9] = [
    "Pictures of 480 x 270, 60 degrees, 8 km, 2 px, no sea and no plants; half of the poses lie on islands \
     all over the world, from eye level to 2 km.",
    "Light jump: light of sun and sky on white ground, linear; pairs of neighbouring pixels whose distances \
     differ by at most 3 %; the larger light less the smaller one over their sum. Middle lines of chunks \
     are no borders and lie at the same distances. One pair in a thousand crosses the edge of a shadow, \
     where light changes threefold: p99.9 shows jumps of that size alone. The bar of the median is half \
     of the least contrast that an eye sees.",
    "Shadow: sun at 15 degrees; pixels from which the land hides the middle of the sun, on ground that is \
     turned to the sun at least as far as level ground; mean of a pose, median of poses with at least 200 \
     such pixels. Noon: sun at 60 degrees.",
    "Power spectrum: luminance of 256 x 256 pixels straight below the eye, linear, before tone mapping; \
     geometric mean over a third as many places. Octaves of wavelengths against a power that falls as \
     the frequency to the -2.4: twice the mean exponent of the amplitude of 135 photographs (Tolhurst, \
     Tadmor and Chao, 1992), of which single ones range from -1.6 to -3.0.",
    "Near planes: eyes in the ground at steep places, raised as the viewer does; 5 fields of view from 30 to \
     170 degrees x vertical scales of 1, 1.8 and 4; magenta background.",
    "Floors: share of the sun from pictures with and without objects, wrong if it differs by 0.25 from \
     that of 61 rays in f64 over the sun's disc, past the shapes without their reliefs; six poses of \
     320 x 180.",
    "Impostors: trees between 1 and 1.4 times the distance where impostors begin, 640 x 360, no wind; \
     pixels that show one in either picture. Light and pixels: without shadows of trees.",
    "Shadows of trees: 8,000 places of a wood, share of the sun wrong if it differs by 0.1 from 61 rays \
     over the sun's disc through all trees; worst of suns at 20, 35 and 60 degrees. 600 to 1,100 m away: \
     the densest square of 180 m. Far: means of blocks of 30 m by the share of woods, which shades where \
     crowns are narrower than 3 pixels.",
    "Frames: 640 x 360, start of the island, rounds of one frame each. Bare frame: 8 km, 2 px, one \
     sample, normals of the drawn triangles, no plants. Earlier frame with plants: the same with 16 clumps \
     of grass and 2 trees a cell, geometry up to 1,500 m, no shadows of plants. Everything on: --quality \
     medium, one sample.",
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
            "borders": { "land": { "ratio": 1.0, "median_ratio": 1.0, "median_excess": 0.0, "pairs": 9 },
                         "mesh": { "ratio": 1.1, "median_excess": 0.001 },
                         "planted": { "ratio": 1.2, "median_excess": 0.01 } },
            "tolerance": { "land": 0.01, "mesh": 0.05, "land_light": 0.01, "mesh_light": 0.04,
                           "still": 0.01, "mesh_still": 0.04 },
            "shadow": { "poses": 20, "over_light": 0.3, "noon_pixels": 10, "black_at_noon": 0 },
            "spectrum": { "near": { "exponent": -2.4, "factor": 1.5 },
                          "middle": { "exponent": -2.4, "factor": 1.5 },
                          "far": { "exponent": -2.4, "factor": 1.5 },
                          "blurred": { "factor": 9.0 }, "white": { "factor": 9.0 } },
            "unlit": 0,
            "lifted": { "magenta": 0, "magenta_before": 5 },
            "floor": { "pixels": 1000, "wrong": 1, "control": 50 },
            "impostors": { "poses": 15, "flip": 0.04, "picture": 0.01, "moved": 0.02, "smooth": 0.02,
                           "luminance": 1.0, "cover": 1.0, "without": 0.4 },
            "tree_shadow": { "near": 0.01, "distant": 0.01, "distant_control": 0.2, "far": 0.0,
                             "far_mean": 0.0, "control": 0.2, "far_control": 0.5 },
            "frame_time": { "is_software": true, "default_over_bare": 0.4, "default_over_bare_p99": 0.4,
                            "all_over_planted": 1.5, "all_over_planted_slowest": 1.5 },
        })
    }

    fn missed(visual: &Value) -> usize {
        rows(visual).iter().filter(|row| row.is_missed()).count()
    }

    #[test]
    fn a_good_report_meets_every_bar_and_an_empty_or_short_one_none() {
        assert_eq!(missed(&visual()), 0);
        assert_eq!(missed(&Value::Null), rows(&visual()).len());
        let mut short = visual();
        short["poses"] = json!(59);
        assert_eq!(missed(&short), rows(&visual()).len());
    }

    #[test]
    fn figures_of_few_pictures_are_missed() {
        for (path, poses) in [("/shadow/poses", 19), ("/impostors/poses", 9)] {
            let mut visual = visual();
            *visual.pointer_mut(path).unwrap() = json!(poses);
            assert_eq!(missed(&visual), 2, "{path}");
        }
    }

    #[test]
    fn no_two_rows_have_one_name() {
        let mut names: Vec<_> = rows(&visual()).into_iter().map(|row| row.name).collect();
        let count = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), count);
    }

    #[test]
    fn each_bar_can_be_missed() {
        for (path, value) in [
            ("/borders/land/ratio", json!(1.06)),
            ("/borders/planted/ratio", json!(1.04)),
            ("/borders/land/median_excess", json!(0.006)),
            ("/borders/planted/median_excess", json!(0.004)),
            ("/tolerance/land", json!(0.02)),
            ("/tolerance/land_light", json!(0.02)),
            ("/shadow/over_light", json!(0.2)),
            ("/shadow/over_light", json!(0.5)),
            ("/shadow/black_at_noon", json!(1)),
            ("/spectrum/near/factor", json!(2.1)),
            ("/spectrum/middle/factor", json!(2.1)),
            ("/spectrum/far/factor", json!(2.1)),
            ("/spectrum/blurred/factor", json!(1.9)),
            ("/spectrum/white/factor", json!(1.9)),
            ("/unlit", json!(1)),
            ("/lifted/magenta", json!(1)),
            ("/lifted/magenta_before", json!(0)),
            ("/floor/wrong", json!(6)),
            ("/floor/control", json!(4)),
            ("/impostors/flip", json!(0.06)),
            ("/impostors/without", json!(0.04)),
            ("/tree_shadow/near", json!(0.03)),
            ("/tree_shadow/control", json!(0.01)),
            ("/tree_shadow/distant", json!(0.06)),
            ("/tree_shadow/distant_control", json!(0.04)),
            ("/tree_shadow/far", json!(0.06)),
            ("/tree_shadow/far_control", json!(0.04)),
            ("/frame_time/default_over_bare", json!(0.6)),
            ("/frame_time/default_over_bare_p99", json!(0.6)),
            ("/frame_time/all_over_planted", json!(2.1)),
            ("/frame_time/all_over_planted_slowest", json!(2.1)),
        ] {
            let mut visual = visual();
            *visual.pointer_mut(path).unwrap() = value;
            assert_eq!(missed(&visual), 1, "{path}");
        }
    }
}
