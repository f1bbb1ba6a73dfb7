//! The view of a client. Integers only: NaN and infinity cannot be expressed.

use crate::limits::MAX_VIEWPORT;
use serde::{Deserialize, Serialize};
use terrain::constants::{CHUNK_BITS, UNITS_PER_METRE, WORLD_HALF};
use terrain::lod::{MAX_VIEW_DISTANCE_M, Needed, Viewer};
use terrain::{ChunkKey, Position};

/// How far ahead of a moving view the server fetches, seconds.
pub const AHEAD_S: i64 = 2;

/// One camera with its tolerated screen error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct View {
    /// Chosen by the client, repeated when the view is settled or refused.
    pub id: u32,
    /// Eye in units of 1/256 m: east, up, south. East and south inside the world.
    pub eye: [i32; 3],
    /// Velocity in units a second, same axes.
    pub velocity: [i32; 3],
    /// Heading in 1/1000 degree: 0 is north (-z), 90,000 is east.
    pub yaw_mdeg: i32,
    /// Elevation of the view direction in 1/1000 degree, up is positive.
    pub pitch_mdeg: i32,
    /// Vertical field of view in 1/1000 degree: 1,000 to 170,000.
    pub fov_mdeg: u32,
    /// Viewport in pixels, width and height, each 1 to [`MAX_VIEWPORT`].
    pub viewport: [u16; 2],
    /// Tolerated screen error in 1/16 pixel, at least 1.
    pub tolerance_q4: u16,
    /// View distance in metres, at most [`MAX_VIEW_DISTANCE_M`].
    pub distance_m: u32,
}

impl View {
    /// Checks every range.
    ///
    /// # Errors
    /// One sentence with field, value and allowed range.
    pub fn check(&self) -> Result<(), String> {
        Position::new(self.eye[0], self.eye[2]).map_err(|error| error.to_string())?;
        if !(1_000..=170_000).contains(&self.fov_mdeg) {
            return Err(format!("field of view {} is not within 1000 to 170000 mdeg", self.fov_mdeg));
        }
        if self.viewport.iter().any(|side| !(1..=MAX_VIEWPORT).contains(side)) {
            let [width, height] = self.viewport;
            return Err(format!(
                "viewport {width} x {height} is not within 1 to {MAX_VIEWPORT} pixels a side"
            ));
        }
        if self.tolerance_q4 == 0 {
            return Err("tolerance 0 is below the minimum of 1/16 pixel".into());
        }
        if self.distance_m > MAX_VIEW_DISTANCE_M {
            return Err(format!(
                "view distance {} m exceeds the maximum of {MAX_VIEW_DISTANCE_M} m",
                self.distance_m
            ));
        }
        Ok(())
    }

    /// The part of a view that determines the needed chunks, for checked views.
    #[must_use]
    pub fn viewer(&self) -> Viewer {
        Viewer {
            eye: self.eye.into(),
            distance_m: self.distance_m,
            pixels_per_radian: pixels_per_radian(self.viewport[1], self.fov_mdeg),
            tolerance_q4: u32::from(self.tolerance_q4),
        }
    }

    /// The viewer in [`AHEAD_S`] seconds at its present velocity, for prefetch; none below 64 m/s,
    /// at which it moves by a finest chunk in that time. At most half of the view distance away, so
    /// that prefetched chunks border on visible ones. Integers, so that two machines choose the
    /// same chunks.
    #[must_use]
    pub fn prefetch_viewer(&self) -> Option<Viewer> {
        let viewer = self.viewer();
        // Clamped to 2,000 km/s: beyond every view distance, and the squares stay in range.
        let [east, _, south] =
            self.velocity.map(|velocity| i64::from(velocity).clamp(-(1 << 29), 1 << 29) * AHEAD_S);
        let way = (east * east + south * south).isqrt();
        // The next view arrives early enough.
        if way < 1 << CHUNK_BITS {
            return None;
        }
        let reach = way.min(i64::from(self.distance_m) * i64::from(UNITS_PER_METRE) / 2);
        let limit = i64::from(WORLD_HALF - 1);
        let moved = |from: i32, by: i64| (i64::from(from) + by * reach / way).clamp(-limit, limit) as i32;
        let (x, y, z) = viewer.eye;
        Some(Viewer { eye: (moved(x, east), y, moved(z, south)), ..viewer })
    }

    /// The priority of a needed chunk; larger is sooner. The gain in screen error, times a factor
    /// of visibility (a quarter outside the horizontal field of view), times a factor of age (up to
    /// four for a chunk that was pending in many views).
    #[must_use]
    pub fn priority(&self, needed: &Needed, views_waited: u32) -> u64 {
        let seen = if self.faces(needed.key) { 4 } else { 1 };
        let age = 16 + u64::from(views_waited.min(48));
        u64::from(needed.gain_q4) * seen * age
    }

    /// Whether a chunk's bounding circle intersects the horizontal field of view. Floats suffice:
    /// the result only affects the order.
    fn faces(&self, key: ChunkKey) -> bool {
        let half_side = f64::from(key.side()) / 2.0;
        let (x, z) = key.origin();
        let east = f64::from(x) + half_side - f64::from(self.eye[0]);
        let south = f64::from(z) + half_side - f64::from(self.eye[2]);
        let (distance, radius) = (east.hypot(south), half_side * std::f64::consts::SQRT_2);
        if distance <= radius {
            return true;
        }
        let [width, height] = self.viewport.map(f64::from);
        let half_fov = ((mdeg(self.fov_mdeg as i32) / 2.0).tan() * width / height).atan();
        // A pitched view covers a wider sector of the ground.
        let widened = if self.pitch_mdeg.unsigned_abs() > 45_000 { std::f64::consts::PI } else { half_fov };
        let bearing = east.atan2(-south) - mdeg(self.yaw_mdeg);
        let off_axis = bearing.sin().atan2(bearing.cos()).abs();
        off_axis <= widened + (radius / distance).asin()
    }
}

/// `K` of the screen-error rule in whole pixels, at least 1; rounded up, so that no error is
/// underestimated.
///
/// The same integer on every machine. Of all valid heights and fields of view, `K` is a whole
/// number only at 90 degrees. Elsewhere it is farther from one than 2^-46 of itself (a search over
/// all of them), which is more than the rounding of a tangent in f64.
#[must_use]
pub fn pixels_per_radian(viewport_height: u16, fov_mdeg: u32) -> u32 {
    if fov_mdeg == 90_000 {
        // The tangent of 45 degrees is 1, and less in f64.
        return u32::from(viewport_height.div_ceil(2)).max(1);
    }
    let k = f64::from(viewport_height) / (2.0 * (mdeg(fov_mdeg as i32) / 2.0).tan());
    (k.ceil() as u32).max(1)
}

fn mdeg(angle: i32) -> f64 {
    (f64::from(angle) / 1000.0).to_radians()
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::hash::mix;

    fn view() -> View {
        View {
            id: 1,
            eye: [0, 100 * 256, 0],
            velocity: [0; 3],
            yaw_mdeg: 0,
            pitch_mdeg: 0,
            fov_mdeg: 60_000,
            viewport: [640, 360],
            tolerance_q4: 32,
            distance_m: 8000,
        }
    }

    #[test]
    fn a_sixty_degree_view_of_360_lines_has_312_pixels_per_radian() {
        assert_eq!(view().viewer().pixels_per_radian, 312);
    }

    #[test]
    fn at_a_right_angle_k_is_half_of_the_height_rounded_up() {
        for height in 0..=MAX_VIEWPORT {
            assert_eq!(pixels_per_radian(height, 90_000), u32::from(height).div_ceil(2).max(1));
        }
    }

    /// The two K that are the nearest to a whole number, by 40 digits: 5669.99999999926 (the least
    /// distance) and 201960.9999999968 (the least share of K).
    #[test]
    fn k_is_rounded_up_where_it_is_nearly_whole() {
        assert_eq!(pixels_per_radian(7_061, 63_818), 5_670);
        assert_eq!(pixels_per_radian(16_202, 4_594), 201_961);
    }

    #[test]
    fn each_field_out_of_range_is_refused_by_name() {
        type Corrupt = fn(&mut View);
        let broken: [(&str, Corrupt); 6] = [
            ("outside the world", |v| v.eye[0] = i32::MAX),
            ("field of view 0", |v| v.fov_mdeg = 0),
            ("field of view 180000", |v| v.fov_mdeg = 180_000),
            ("viewport 0", |v| v.viewport[0] = 0),
            ("tolerance 0", |v| v.tolerance_q4 = 0),
            ("view distance", |v| v.distance_m = u32::MAX),
        ];
        assert_eq!(view().check(), Ok(()));
        for (word, corrupt) in broken {
            let mut corrupted = view();
            corrupt(&mut corrupted);
            assert!(corrupted.check().unwrap_err().contains(word), "{word}");
        }
        let least = View { fov_mdeg: 1_000, viewport: [1; 2], tolerance_q4: 1, distance_m: 0, ..view() };
        let most = View { fov_mdeg: 170_000, viewport: [MAX_VIEWPORT; 2], ..view() };
        for allowed in [least, View { distance_m: MAX_VIEW_DISTANCE_M, ..most }] {
            assert_eq!(allowed.check(), Ok(()));
        }
    }

    #[test]
    fn what_lies_ahead_comes_before_what_lies_behind_and_waiting_helps() {
        let priority = |x, z, waited| {
            let key = ChunkKey::new(0, x, z).unwrap();
            view().priority(&Needed { key, distance: 1, gain_q4: 100 }, waited)
        };
        let (ahead, behind) = (priority(0, -20, 0), priority(0, 20, 0));
        assert!(ahead > behind);
        assert!(priority(20, 0, 0) < ahead, "east is outside a northward view");
        assert!(priority(0, 20, 40) > behind);
        assert_eq!((ahead, priority(0, 20, 48)), (4 * behind, 4 * behind), "a quarter; up to four times");
        assert_eq!(priority(0, 20, 1000), priority(0, 20, 48));
    }

    #[test]
    fn prefetch_stays_within_half_the_distance_and_the_world() {
        let ahead =
            |velocity, eye| View { velocity, eye, ..view() }.prefetch_viewer().map(|viewer| viewer.eye);
        assert_eq!(ahead([0; 3], [0; 3]), None);
        assert_eq!(ahead([1000, i32::MAX, 0], [0; 3]), None, "walking, or falling");
        let speed = 100 * UNITS_PER_METRE;
        assert_eq!(ahead([speed, 5, 0], [7, 8, 9]), Some((7 + 2 * speed, 8, 9)));
        // 128 m in two seconds, the side of a finest chunk.
        assert_eq!(ahead([64 * UNITS_PER_METRE, 0, 0], [0; 3]), Some((128 * UNITS_PER_METRE, 0, 0)));
        assert_eq!(ahead([64 * UNITS_PER_METRE - 1, 0, 0], [0; 3]), None);
        let half = 4000 * UNITS_PER_METRE;
        assert_eq!(ahead([0, 0, i32::MIN], [0; 3]), Some((0, 0, -half)));
        for extreme in [i32::MIN, i32::MAX] {
            for edge in [-WORLD_HALF, WORLD_HALF] {
                let (x, _, z) = ahead([extreme; 3], [edge, 0, -edge]).unwrap();
                assert!(Position::new(x, z).is_ok(), "{x} {z}");
            }
        }
        let inside = (WORLD_HALF - 1, 0, 1 - WORLD_HALF);
        assert_eq!(ahead([i32::MAX, 0, i32::MIN], [WORLD_HALF, 0, -WORLD_HALF]), Some(inside));
    }

    /// By the angle between the directions of the view and to the middle of a chunk, half of the
    /// field of view, and the angle of the chunk's bounding circle.
    #[test]
    fn a_view_faces_a_chunk_whose_circle_reaches_into_its_field_of_view() {
        let mut faced = 0;
        for n in 0..2000 {
            let at = |stream: u32, range: u32| (mix(8 * n + stream) % (2 * range)) as i32 - range as i32;
            let key = ChunkKey::new((n % 3) as u8, at(0, 6), at(1, 6)).unwrap();
            let view = View {
                eye: [at(2, 100_000), 25_600, at(3, 100_000)],
                yaw_mdeg: at(4, 720_000),
                fov_mdeg: 20_000 + mix(8 * n + 5) % 100_000,
                viewport: [640, 360 + (mix(8 * n + 6) % 1000) as u16],
                ..view()
            };
            let side = f64::from(key.side());
            let middle = |coordinate: i32| (f64::from(coordinate) + 0.5) * side;
            let (east, south) =
                (middle(key.x()) - f64::from(view.eye[0]), middle(key.z()) - f64::from(view.eye[2]));
            let (distance, radius) = (east.hypot(south), side / 2f64.sqrt());
            let radians = |mdeg: f64| mdeg / 180_000.0 * std::f64::consts::PI;
            let yaw = radians(f64::from(view.yaw_mdeg));
            let angle = ((east * yaw.sin() - south * yaw.cos()) / distance).acos();
            let half = radians(f64::from(view.fov_mdeg)) / 2.0;
            let [width, height] = view.viewport.map(f64::from);
            let reach = (width * half.sin()).atan2(height * half.cos()) + (radius / distance).min(1.0).asin();
            let expected = distance <= radius || angle <= reach;
            assert_eq!(view.faces(key), expected, "{view:?} {key}");
            faced += u32::from(expected);
        }
        assert!((400..600).contains(&faced), "{faced}");
        // Steeply upwards or downwards a view covers all directions.
        let behind = ChunkKey::new(0, 0, 50).unwrap();
        for (pitch_mdeg, expected) in [(45_000, false), (45_001, true), (-45_000, false), (-45_001, true)] {
            assert_eq!(View { pitch_mdeg, ..view() }.faces(behind), expected, "{pitch_mdeg}");
        }
    }

    #[test]
    fn facing_wraps_around_north() {
        let north_west = View { yaw_mdeg: -350_000, ..view() };
        assert!(north_west.faces(ChunkKey::new(0, 0, -50).unwrap()), "-350 degrees is 10 degrees");
        let south = View { yaw_mdeg: 180_000, ..view() };
        assert!(
            south.faces(ChunkKey::new(0, 0, 50).unwrap()) && !south.faces(ChunkKey::new(0, 0, -50).unwrap())
        );
    }
}
