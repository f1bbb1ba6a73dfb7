//! Controls: fields that must miss the bars of the land, through the same code.

use super::centres::{self, Peak};
use super::features;
use super::field::{Changed, Field, Formula, LEVEL, SPACING_M, Window};
use super::shape::{Figures, Shape};
use crate::sample::{unit, word};
use serde::Serialize;
use terrain::Land;
use terrain::constants::{SPACING_BITS, UNITS_PER_METRE};

/// Results of the controls. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
pub struct Controls {
    /// Round islands with sides of 25 degrees.
    pub cones: Figures,
    /// Round islands with walls of 60 degrees up to a table of 30 m.
    pub tables: Figures,
    /// The land at an eighth of its height.
    pub low: Figures,
    /// The land with up to 20 m of white noise.
    pub rough: Figures,
    /// The land with waves of 40 m along x.
    pub waves: Figures,
    /// Centres on a lattice of 16 km with a jitter of 10 %, and anywhere.
    pub lattice: Option<Peak>,
    pub independent: Option<Peak>,
    /// Cones in whose middle all features lie.
    pub featured_cones: u32,
}

/// Metres between round islands, and their radius.
const ROUND_M: (f64, f64) = (8192.0, 2000.0);

/// Round islands whose sides have a slope up to a height, metres; the middle of one is the origin.
pub fn round(slope: f64, top_m: f64) -> impl Field {
    let near = |metres: f64| (metres + ROUND_M.0 / 2.0).rem_euclid(ROUND_M.0) - ROUND_M.0 / 2.0;
    Formula(move |x, z| ((ROUND_M.1 - near(x).hypot(near(z))) * slope).clamp(-64.0, top_m))
}

/// Measures all controls; the changed lands in a window that has land.
pub fn measure(land: Land, window: &Window) -> Controls {
    let cones = || round(25f64.to_radians().tan(), 1000.0);
    let islands = (4.0 * ROUND_M.0 / SPACING_M) as usize;
    // Half a cell from the middle of an island, so that none lies on the edge.
    let corner = (ROUND_M.0 / 2.0) as i32 * UNITS_PER_METRE;
    let squared = Window::around((corner, corner), islands, 64);
    let rough = |x: i32, z: i32, height: f32| {
        height + 20.0 * unit(word((x >> (SPACING_BITS + u32::from(LEVEL))) as u32, z as u32)) as f32
    };
    let waves = |x: i32, _: i32, height: f32| {
        let along = f64::from(x) / f64::from(UNITS_PER_METRE) * std::f64::consts::TAU / 40.0;
        height + 40.0 * along.sin() as f32
    };
    let shape = |field: &dyn Field, window: &Window| Shape::of(field, window).figures();
    Controls {
        cones: shape(&cones(), &squared),
        tables: shape(&round(60f64.to_radians().tan(), 30.0), &squared),
        low: shape(&Changed(land, |_, _, height| height / 8.0), window),
        rough: shape(&Changed(land, rough), window),
        waves: shape(&Changed(land, waves), window),
        lattice: centres::peak(&centres::jittered_lattices(4)),
        independent: centres::peak(&centres::independent(4)),
        featured_cones: u32::from(features::near(&cones(), (0, 0)) == [true; 6]),
    }
}
