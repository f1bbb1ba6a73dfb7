//! Places of a world that a visitor wants to see, found in its land. The search is cut into slices
//! of a few milliseconds, so that a window can run one a frame.

mod survey;
mod woods;

use crate::camera::{MAX_EYE_HEIGHT_M, Pose};
use clap::ValueEnum;
use glam::{DVec2, DVec3};
use std::ops::Range;
use survey::{Scored, Spot, Survey, bearing};
use terrain::Land;
use terrain::constants::UNITS_PER_METRE;
use terrain::lod::MAX_VIEW_DISTANCE_M;

/// Samples of sea, 64 m apart, that end an island.
const OPEN_SEA_SAMPLES: u32 = 6;

/// A place of the home island or above it. The keys 1 to 8 go to them in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Place {
    /// A beach, along the water
    Beach,
    /// The highest place
    Summit,
    /// The floor of a valley, up along it
    Valley,
    /// The edge of a wood
    Forest,
    /// A cliff, from the sea
    Cliff,
    /// The nearest other island, with mountains if one has them, from the sea before it
    NextIsland,
    /// The home island from 2 km above the sea
    #[value(name = "2km")]
    From2Km,
    /// The archipelago from 20 km above the sea
    #[value(name = "20km")]
    From20Km,
}

impl Place {
    /// All of them, in the order of their keys.
    pub const ALL: [Self; 8] = [
        Self::Beach,
        Self::Summit,
        Self::Valley,
        Self::Forest,
        Self::Cliff,
        Self::NextIsland,
        Self::From2Km,
        Self::From20Km,
    ];

    /// Its name in the panel.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::Beach => "beach",
            Self::Summit => "summit",
            Self::Valley => "valley",
            Self::Forest => "forest",
            Self::Cliff => "cliff",
            Self::NextIsland => "next island",
            Self::From2Km => "2 km up",
            Self::From20Km => "20 km up",
        }
    }

    /// View distance that the place needs, metres; 0 for any.
    #[must_use]
    pub fn view_distance_m(self) -> u32 {
        match self {
            Self::From2Km => 20_000,
            Self::From20Km => MAX_VIEW_DISTANCE_M,
            _ => 0,
        }
    }
}

/// Searches the places of a world.
#[derive(Clone, Debug)]
pub struct PlaceFinder {
    land: Land,
    vertical_scale: f64,
    survey: Survey,
    /// Best spot of the place that is searched, and the number of bands searched.
    best: Option<Scored>,
    bands: usize,
    found: Vec<Pose>,
}

impl PlaceFinder {
    /// A search that has not begun. Heights are multiplied by `vertical_scale`.
    #[must_use]
    pub fn new(land: Land, vertical_scale: f64) -> Self {
        let found = Vec::with_capacity(Place::ALL.len());
        Self { land, vertical_scale, survey: Survey::new(), best: None, bands: 0, found }
    }

    /// Runs one slice; whether all places are found.
    pub fn advance(&mut self) -> bool {
        if let Some(place) = Place::ALL.get(self.found.len())
            && self.survey.advance(&self.land)
            && let Some(pose) = self.search(*place)
        {
            (self.best, self.bands) = (None, 0);
            self.found.push(pose);
        }
        self.found.len() == Place::ALL.len()
    }

    /// A place, if it is found.
    #[must_use]
    pub fn get(&self, place: Place) -> Option<Pose> {
        let index = Place::ALL.iter().position(|other| *other == place)?;
        self.found.get(index).copied()
    }

    /// Searches one band of rows for a place; the pose after the last band.
    fn search(&mut self, place: Place) -> Option<Pose> {
        let (height_m, pitch_deg) = match place {
            Place::Beach => (1.8, -2.0),
            Place::Summit => (3.0, -9.0),
            Place::Valley => (8.0, 1.0),
            Place::Forest => (2.4, 3.0),
            Place::Cliff => (12.0, 3.0),
            Place::NextIsland => return Some(self.next_island()),
            // From the sunny side: the sun of the scene stands in the south-east.
            Place::From2Km => return Some(pose(DVec3::new(-1400.0, 2000.0, 4200.0), 18.0, -24.0)),
            Place::From20Km => {
                return Some(pose(DVec3::new(-2000.0, MAX_EYE_HEIGHT_M, 16_000.0), 8.0, -50.0));
            }
        };
        if let Some(rows) = survey::bands().nth(self.bands) {
            self.bands += 1;
            self.best = survey::best(self.best.into_iter().chain(self.spot(place, rows)));
            return None;
        }
        // Without a spot the middle of the island.
        let Spot { at, yaw_deg } = self.best.map(|(_, spot)| spot).unwrap_or_default();
        let ground_m = self.ground_m(at).max(0.0);
        Some(pose(DVec3::new(at.x, ground_m + height_m, at.y), yaw_deg, pitch_deg))
    }

    fn spot(&self, place: Place, rows: Range<usize>) -> Option<Scored> {
        match place {
            Place::Beach => self.survey.beach(rows),
            Place::Summit => self.survey.summit(rows),
            Place::Valley => self.survey.valley(rows),
            Place::Forest => self.survey.wood_edge(rows),
            Place::Cliff => self.survey.cliff(rows),
            Place::NextIsland | Place::From2Km | Place::From20Km => None,
        }
    }

    fn next_island(&self) -> Pose {
        let middle = survey::next_island(&self.land);
        let out = -middle.normalize_or(DVec2::X);
        // From its middle towards the home island: the last land before the open sea.
        let (mut coast, mut sea) = (middle, 0);
        for step in 0..128 {
            let at = middle + out * (64.0 * f64::from(step));
            let is_land = survey::outline_m(&self.land, at) > 0.0;
            (coast, sea) = if is_land { (at, 0) } else { (coast, sea + 1) };
            if sea == OPEN_SEA_SAMPLES && coast != middle {
                break;
            }
        }
        let at = coast + out * 650.0;
        let ground_m = self.ground_m(at).max(0.0);
        pose(DVec3::new(at.x, ground_m + 70.0, at.y), bearing(-out), -4.0)
    }

    /// Height of the land, metres.
    fn ground_m(&self, at: DVec2) -> f64 {
        survey::height_m(&self.land, at, terrain::Octaves::ALL) * self.vertical_scale
    }
}

/// A place of a world, searched in one go: not for a frame.
#[must_use]
pub fn find(place: Place, land: &Land, vertical_scale: f64) -> Pose {
    let mut finder = PlaceFinder::new(*land, vertical_scale);
    while !finder.survey.advance(land) {}
    loop {
        if let Some(pose) = finder.search(place) {
            return pose;
        }
    }
}

/// In tenths of metres and degrees, which a written pose holds.
fn pose(position_m: DVec3, yaw_deg: f64, pitch_deg: f64) -> Pose {
    let tenths = |value: f64| (value * 10.0).round() / 10.0;
    let [x, y, z] = position_m.to_array().map(tenths);
    let yaw_deg = tenths(yaw_deg.rem_euclid(360.0)).rem_euclid(360.0);
    Pose { position_m: DVec3::new(x, y, z), yaw_deg, pitch_deg }.clamped()
}

/// Units at a place in metres.
fn units(metres: f64) -> i32 {
    (metres * f64::from(UNITS_PER_METRE)) as i32
}

#[cfg(test)]
mod tests {
    use super::survey::towards;
    use super::*;
    use terrain::Octaves;

    fn ahead(pose: &Pose, metres: f64) -> DVec2 {
        DVec2::new(pose.position_m.x, pose.position_m.z) + towards(pose.yaw_deg) * metres
    }

    #[test]
    fn every_world_has_the_places_that_their_names_promise() {
        for seed in 0..6 {
            let land = Land::new(seed);
            let mut finder = PlaceFinder::new(land, 1.0);
            let mut slices = 0;
            while !finder.advance() {
                slices += 1;
                assert!(slices < 400);
            }
            let get = |place| finder.get(place).unwrap();
            let height = |at: DVec2| survey::height_m(&land, at, Octaves::ALL);
            let ground = |place| height(ahead(&get(place), 0.0));
            for place in Place::ALL {
                let pose = get(place);
                assert_eq!(pose, find(place, &land, 1.0), "world {seed}: {place:?}");
                assert_eq!(pose.to_string().parse::<Pose>(), Ok(pose), "a written pose is the same");
                assert!(
                    pose.position_m.y > ground(place).max(0.0) + 1.0,
                    "world {seed}: {place:?} at {pose}"
                );
            }
            let summit = ground(Place::Summit);
            assert!(summit > 120.0, "world {seed}: a summit of {summit} m");
            assert!((-1.0..4.0).contains(&ground(Place::Beach)), "world {seed}: {}", get(Place::Beach));
            let valley = ahead(&get(Place::Valley), 0.0);
            let side = towards(get(Place::Valley).yaw_deg + 90.0);
            let wall = |sign: f64| {
                (1..=10).map(|n| height(valley + side * (sign * 32.0 * f64::from(n)))).fold(0.0, f64::max)
            };
            let depth = wall(1.0).min(wall(-1.0)) - height(valley);
            assert!(depth > 20.0, "world {seed}: a valley {depth} m deep");
            assert!(ground(Place::Forest) > 10.0 && ground(Place::Forest) < summit);
            assert!(ground(Place::Cliff) < 0.0, "world {seed}: the cliff is seen from the sea");
            let cliff = (1..=30).map(|n| height(ahead(&get(Place::Cliff), 10.0 * f64::from(n))));
            assert!(cliff.fold(0.0, f64::max) > 25.0, "world {seed}: {}", get(Place::Cliff));
            let next = get(Place::NextIsland);
            let land_ahead = (1..=40).any(|n| height(ahead(&next, 50.0 * f64::from(n))) > 0.0);
            assert!(land_ahead && ahead(&next, 0.0).length() > 3000.0, "world {seed}: {next}");
        }
    }
}
