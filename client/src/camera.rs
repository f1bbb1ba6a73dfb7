//! Camera: poses, projections, flying and orbiting. Pure arithmetic; time is passed as steps.
//!
//! World axes: x east, y up, z south. Yaw 0 looks north (-z) and increases to the right (east);
//! pitch increases upward.

use glam::camera::rh::{proj::directx::perspective_infinite_reverse, view::look_to_mat4};
use glam::{DVec3, Mat4, Vec3};
use std::fmt;
use std::str::FromStr;
use terrain::constants::{UNITS_PER_METRE, WORLD_HALF};

/// Highest eye, metres. Above it the horizon of a flat world would need more than 64 km of land.
pub const MAX_EYE_HEIGHT_M: f64 = 20_000.0;
/// Lowest eye, metres: the open sea floor.
pub const MIN_EYE_HEIGHT_M: f64 = -64.0;
/// Largest |x| and |z| of an eye, metres.
pub const WORLD_HALF_M: f64 = (WORLD_HALF / UNITS_PER_METRE) as f64;
/// Least distance of an eye from the drawn land, metres, in any direction. The near plane lies
/// wholly within it ([`Projection::near_m`]), so it never cuts the land.
pub const CLEARANCE_M: f64 = 0.5;
/// Share of the clearance that the near plane's corners may reach; the rest is for rounding.
const NEAR_SHARE: f64 = 0.98;
/// Largest pitch, degrees: straight up or down. The yaw keeps the heading.
pub const MAX_PITCH_DEG: f64 = 90.0;

/// Position and direction of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Metres east, up, south.
    pub position_m: DVec3,
    /// Heading in degrees, clockwise from north.
    pub yaw_deg: f64,
    /// Elevation of the view direction, degrees, within ±[`MAX_PITCH_DEG`].
    pub pitch_deg: f64,
}

/// An eye position split for exact arithmetic: whole units and the fraction of a unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eye {
    /// East, up, south in units of 2^-8 m.
    pub units: [i32; 3],
    /// The fraction, metres, 0 to 2^-8 each.
    pub fraction_m: Vec3,
}

impl Pose {
    /// Unit vector of the view direction.
    #[must_use]
    pub fn forward(&self) -> DVec3 {
        let (yaw, pitch) = (self.yaw_deg.to_radians(), self.pitch_deg.to_radians());
        DVec3::new(yaw.sin() * pitch.cos(), pitch.sin(), -yaw.cos() * pitch.cos())
    }

    /// Unit vector to the right of the image; horizontal.
    #[must_use]
    pub fn right(&self) -> DVec3 {
        let yaw = self.yaw_deg.to_radians();
        DVec3::new(yaw.cos(), 0.0, yaw.sin())
    }

    /// Unit vector to the top of the image.
    #[must_use]
    pub fn up(&self) -> DVec3 {
        self.right().cross(self.forward())
    }

    /// The eye for integer-origin rendering. Positions outside the world are clamped.
    #[must_use]
    pub fn eye(&self) -> Eye {
        let scale = f64::from(UNITS_PER_METRE);
        let clamped = self.clamped().position_m * scale;
        let whole = clamped.floor();
        Eye {
            units: [whole.x as i32, whole.y as i32, whole.z as i32],
            fraction_m: ((clamped - whole) / scale).as_vec3(),
        }
    }

    /// The pose raised above the ground height (units) if it is below. An eye under water stays
    /// there. Enough before the drawn chunks are known; then
    /// [`clearance::raised`](crate::lod::clearance::raised) keeps it off the land beside it.
    #[must_use]
    pub fn above(self, ground: Option<i32>) -> Self {
        let floor_m =
            ground.map_or(f64::MIN, |units| f64::from(units) / f64::from(UNITS_PER_METRE) + CLEARANCE_M);
        Self { position_m: self.position_m.with_y(self.position_m.y.max(floor_m)), ..self }
    }

    /// The pose with position and pitch clamped to their ranges.
    #[must_use]
    pub fn clamped(self) -> Self {
        let p = self.position_m;
        Self {
            position_m: DVec3::new(
                p.x.clamp(-WORLD_HALF_M, WORLD_HALF_M),
                p.y.clamp(MIN_EYE_HEIGHT_M, MAX_EYE_HEIGHT_M),
                p.z.clamp(-WORLD_HALF_M, WORLD_HALF_M),
            ),
            yaw_deg: self.yaw_deg.rem_euclid(360.0),
            pitch_deg: self.pitch_deg.clamp(-MAX_PITCH_DEG, MAX_PITCH_DEG),
        }
    }
}

impl fmt::Display for Pose {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let p = self.position_m;
        let digits = f.precision().unwrap_or(1);
        let [x, y, z, yaw, pitch] = [p.x, p.y, p.z, self.yaw_deg, self.pitch_deg];
        write!(f, "{x:.digits$},{y:.digits$},{z:.digits$},{yaw:.digits$},{pitch:.digits$}")
    }
}

/// Why a `X,Y,Z,YAW,PITCH` text is invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PoseError {
    /// Not five numbers.
    #[error("expected X,Y,Z,YAW,PITCH (metres and degrees, five numbers), found {0}")]
    Count(usize),
    /// Not a finite number.
    #[error("{name} is `{text}`, expected a finite number")]
    Number {
        /// Which of the five.
        name: &'static str,
        /// The text.
        text: String,
    },
    /// A number out of range.
    #[error("{name} is {text}, allowed is {low} to {high}")]
    Range {
        /// Which of the five.
        name: &'static str,
        /// The text.
        text: String,
        /// Smallest allowed.
        low: f64,
        /// Largest allowed.
        high: f64,
    },
}

impl FromStr for Pose {
    type Err = PoseError;

    fn from_str(text: &str) -> Result<Self, PoseError> {
        let fields = [
            ("X", -WORLD_HALF_M, WORLD_HALF_M),
            ("Y", MIN_EYE_HEIGHT_M, MAX_EYE_HEIGHT_M),
            ("Z", -WORLD_HALF_M, WORLD_HALF_M),
            ("YAW", -360.0, 360.0),
            ("PITCH", -MAX_PITCH_DEG, MAX_PITCH_DEG),
        ];
        let parts: Vec<&str> = text.split(',').collect();
        if parts.len() != fields.len() {
            return Err(PoseError::Count(parts.len()));
        }
        let mut values = [0.0; 5];
        for ((value, (name, low, high)), part) in values.iter_mut().zip(fields).zip(parts) {
            let number = part.trim().parse::<f64>().ok().filter(|number| number.is_finite());
            *value = number.ok_or_else(|| PoseError::Number { name, text: shown(part) })?;
            if !(low..=high).contains(value) {
                return Err(PoseError::Range { name, text: shown(part), low, high });
            }
        }
        let [x, y, z, yaw_deg, pitch_deg] = values;
        Ok(Self { position_m: DVec3::new(x, y, z), yaw_deg, pitch_deg })
    }
}

/// The beginning of a text, for a message of one short line.
fn shown(text: &str) -> String {
    const MOST: usize = 24;
    let text = text.trim();
    if text.chars().count() <= MOST {
        return text.to_owned();
    }
    format!("{}...", text.chars().take(MOST).collect::<String>())
}

/// Vertical field of view and image size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection {
    /// Vertical field of view, degrees, 1 to 170.
    pub fov_deg: f64,
    /// Width in pixels, at least 1.
    pub width: u32,
    /// Height in pixels, at least 1.
    pub height: u32,
}

/// Distance of the near plane in ordinary lenses, metres. Infinite reversed-Z spends its precision
/// by ratio, so a close plane costs nothing.
pub const NEAR_M: f32 = 0.25;

impl Projection {
    /// Width over height.
    #[must_use]
    pub fn aspect(&self) -> f64 {
        f64::from(self.width) / f64::from(self.height)
    }

    /// Half the height of the image plane at distance 1.
    #[must_use]
    pub fn half_height(&self) -> f64 {
        (self.fov_deg.to_radians() / 2.0).tan()
    }

    /// Distance of the near plane, metres: [`NEAR_M`], or less where its corners would be farther
    /// from the eye than [`CLEARANCE_M`] (wide lenses: 0.19 m at 100 degrees and 16:9).
    #[must_use]
    pub fn near_m(&self) -> f32 {
        let half_height = self.half_height();
        let half_width = half_height * self.aspect();
        let corner = (1.0 + half_height * half_height + half_width * half_width).sqrt();
        NEAR_M.min((NEAR_SHARE * CLEARANCE_M / corner) as f32)
    }

    /// Camera-relative metres (axes of the world) to clip space; infinite reversed-Z.
    #[must_use]
    pub fn clip_from_camera(&self, pose: &Pose) -> Mat4 {
        let clip_from_view = perspective_infinite_reverse(
            self.fov_deg.to_radians() as f32,
            self.aspect() as f32,
            self.near_m(),
        );
        let view_from_camera = look_to_mat4(Vec3::ZERO, pose.forward().as_vec3(), pose.up().as_vec3());
        clip_from_view * view_from_camera
    }
}

/// Input of a flying camera, each axis -1 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Steering {
    /// Along the view direction.
    pub forward: f64,
    /// To the right.
    pub right: f64,
    /// Vertical, world up.
    pub up: f64,
    /// Degrees to turn right now.
    pub turn_deg: f64,
    /// Degrees to look up now.
    pub tilt_deg: f64,
}

/// A free camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fly {
    /// The pose.
    pub pose: Pose,
    /// Speed at full input, metres a second.
    pub speed_m: f64,
}

impl Fly {
    /// Moves for `dt_s` seconds.
    pub fn step(&mut self, steering: &Steering, dt_s: f64) {
        self.pose.yaw_deg += steering.turn_deg;
        self.pose.pitch_deg += steering.tilt_deg;
        self.pose = self.pose.clamped();
        let direction = self.pose.forward() * steering.forward
            + self.pose.right() * steering.right
            + DVec3::Y * steering.up;
        self.pose.position_m += direction.clamp_length_max(1.0) * self.speed_m * dt_s;
        self.pose = self.pose.clamped();
    }
}

/// An orbiting camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// The centre, metres.
    pub centre_m: DVec3,
    /// Horizontal distance to the centre, metres.
    pub radius_m: f64,
    /// Eye height above the sea, metres.
    pub height_m: f64,
    /// Bearing of the eye seen from the centre, degrees clockwise from north.
    pub bearing_deg: f64,
}

impl Orbit {
    /// Steepest direction from the eye to the centre, degrees: a steeper pose turns to it.
    const STEEPEST_DEG: f64 = 80.0;

    /// The orbit through a pose around the point that it looks towards, `ahead_m` away
    /// horizontally.
    #[must_use]
    pub fn through(pose: &Pose, ahead_m: f64) -> Self {
        let level = DVec3::new(pose.yaw_deg.to_radians().sin(), 0.0, -pose.yaw_deg.to_radians().cos());
        let pitch_deg = pose.pitch_deg.clamp(-Self::STEEPEST_DEG, Self::STEEPEST_DEG);
        let centre_m =
            pose.position_m + level * ahead_m + DVec3::Y * (pitch_deg.to_radians().tan() * ahead_m);
        Self {
            centre_m,
            radius_m: ahead_m,
            height_m: pose.position_m.y,
            bearing_deg: (pose.yaw_deg + 180.0).rem_euclid(360.0),
        }
    }

    /// Turns the view up by `tilt_deg` degrees: the eye moves down around the centre.
    pub fn tilt(&mut self, tilt_deg: f64) {
        // A steeper view that keys made stays as it is.
        if tilt_deg == 0.0 {
            return;
        }
        let (rise_m, away_m) = (self.height_m - self.centre_m.y, self.radius_m);
        let angle_deg = rise_m.atan2(away_m).to_degrees();
        let turned_deg = (angle_deg - tilt_deg).clamp(-Self::STEEPEST_DEG, Self::STEEPEST_DEG);
        let distance_m = rise_m.hypot(away_m);
        let (rise, away) = turned_deg.to_radians().sin_cos();
        (self.height_m, self.radius_m) = (self.centre_m.y + rise * distance_m, away * distance_m);
    }

    /// The pose at the current bearing.
    #[must_use]
    pub fn pose(&self) -> Pose {
        let bearing = self.bearing_deg.to_radians();
        let offset = DVec3::new(bearing.sin(), 0.0, -bearing.cos()) * self.radius_m;
        let pitch = (self.centre_m.y - self.height_m).atan2(self.radius_m);
        Pose {
            position_m: (self.centre_m + offset).with_y(self.height_m),
            yaw_deg: (self.bearing_deg + 180.0).rem_euclid(360.0),
            pitch_deg: pitch.to_degrees(),
        }
        .clamped()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec4;
    use proptest::prelude::*;

    fn pose(text: &str) -> Pose {
        text.parse().unwrap()
    }

    fn projection() -> Projection {
        Projection { fov_deg: 60.0, width: 1280, height: 720 }
    }

    #[test]
    fn yaw_turns_right_from_north_and_pitch_looks_up() {
        let close = |a: DVec3, b: DVec3| assert!((a - b).length() < 1e-9, "{a} {b}");
        close(pose("0,0,0,0,0").forward(), -DVec3::Z);
        close(pose("0,0,0,90,0").forward(), DVec3::X);
        close(pose("0,0,0,180,0").forward(), DVec3::Z);
        assert!(pose("0,0,0,0,30").forward().y > 0.49);
        close(pose("0,0,0,0,0").right(), DVec3::X);
        close(pose("0,0,0,123,0").up(), DVec3::Y);
    }

    #[test]
    fn a_point_ahead_lands_in_the_middle_and_depth_falls_with_distance() {
        let clip_from_camera = projection().clip_from_camera(&pose("7,8,9,90,0"));
        let project = |offset: Vec3| {
            let clip: Vec4 = clip_from_camera * offset.extend(1.0);
            clip.truncate() / clip.w
        };
        let near = project(Vec3::new(10.0, 0.0, 0.0));
        let far = project(Vec3::new(10_000.0, 0.0, 0.0));
        assert!(near.x.abs() < 1e-5 && near.y.abs() < 1e-5);
        assert!((near.z - NEAR_M / 10.0).abs() < 1e-6 && (far.z - NEAR_M / 10_000.0).abs() < 1e-8);
        assert!(project(Vec3::new(10.0, 1.0, 0.0)).y > 0.0, "up is up");
        assert!(project(Vec3::new(10.0, 0.0, 1.0)).x > 0.0, "south is right of east");
        let at_infinity = clip_from_camera * Vec4::new(1.0, 0.0, 0.0, 0.0);
        assert!(at_infinity.z == 0.0 && at_infinity.w > 0.0);
    }

    #[test]
    fn each_bad_pose_is_refused_with_name_value_and_range() {
        for (text, words) in [
            ("", "found 1"),
            ("1,2,3,4", "found 4"),
            ("1,2,3,4,5,6", "found 6"),
            ("1,2,x,4,5", "Z is `x`"),
            ("NaN,2,3,4,5", "X is `NaN`"),
            ("1,inf,3,4,5", "Y is `inf`"),
            ("1,1e999,3,4,5", "Y is `1e999`"),
            ("1e300,2,3,4,5", "X is 1e300, allowed"),
            ("4194305,2,3,4,5", "X is 4194305, allowed is -4194304 to 4194304"),
            ("1,20001,3,4,5", "Y is 20001"),
            ("1,2,3,400,5", "YAW is 400"),
            ("1,2,3,4,91", "PITCH is 91, allowed is -90 to 90"),
        ] {
            let message = text.parse::<Pose>().unwrap_err().to_string();
            assert!(message.contains(words), "{text}: {message}");
        }
        let long = format!("{},2,3,4,5", "9".repeat(400));
        assert!(long.parse::<Pose>().unwrap_err().to_string().len() < 90, "long numbers are cut");
    }

    #[test]
    fn flying_stops_at_the_border_of_the_world_and_never_looks_over_the_zenith() {
        let mut fly = Fly { pose: pose("4194300,100,0,90,0"), speed_m: 1000.0 };
        fly.step(&Steering { forward: 1.0, tilt_deg: 500.0, ..Steering::default() }, 10.0);
        assert!(fly.pose.pitch_deg <= MAX_PITCH_DEG && fly.pose.position_m.x <= WORLD_HALF_M);
        assert!(fly.pose.eye().units[0] <= WORLD_HALF);
    }

    #[test]
    fn an_eye_in_the_ground_is_lifted_and_one_in_the_sea_is_not() {
        let eye = pose("5,10,-5,0,0");
        assert_eq!(eye.above(Some(100 * 256)).position_m, DVec3::new(5.0, 100.5, -5.0));
        assert_eq!(eye.above(Some(9 * 256)), eye);
        assert_eq!(pose("5,-10,-5,0,0").above(Some(-40 * 256)).position_m.y, -10.0);
        assert_eq!(eye.above(None), eye);
    }

    #[test]
    fn an_orbit_passes_through_its_pose_and_looks_at_its_centre() {
        let start = pose("100,300,-50,40,-10");
        let orbit = Orbit::through(&start, 2000.0);
        assert!((orbit.pose().position_m - start.position_m).length() < 1e-6);
        let later = Orbit { bearing_deg: orbit.bearing_deg + 77.0, ..orbit }.pose();
        let to_centre = (orbit.centre_m - later.position_m).normalize();
        assert!((to_centre - later.forward()).length() < 1e-9);
        assert!((orbit.pose().pitch_deg - start.pitch_deg).abs() < 1e-9, "the pitch stays");
    }

    #[test]
    fn an_orbit_tilts_around_its_centre_and_not_over_it() {
        let start = Orbit::through(&pose("100,300,-50,40,-10"), 2000.0);
        let away_m = |orbit: &Orbit| (orbit.pose().position_m - orbit.centre_m).length();
        let mut orbit = start;
        orbit.tilt(-15.0);
        assert!(
            (orbit.pose().pitch_deg + 25.0).abs() < 1e-9 && (away_m(&orbit) - away_m(&start)).abs() < 1e-6
        );
        orbit.tilt(-500.0);
        assert!((orbit.pose().pitch_deg + Orbit::STEEPEST_DEG).abs() < 1e-9);
        let before = orbit;
        orbit.tilt(0.0);
        assert_eq!(orbit, before);
    }

    proptest! {
        #[test]
        fn whole_units_and_fraction_are_the_position(
            x in -WORLD_HALF_M..WORLD_HALF_M,
            y in -64.0f64..20_000.0,
        ) {
            let eye = Pose { position_m: DVec3::new(x, y, -x), yaw_deg: 0.0, pitch_deg: 0.0 }.eye();
            prop_assert!(eye.fraction_m.min_element() >= 0.0 && eye.fraction_m.max_element() <= 1.0 / 256.0);
            let back = f64::from(eye.units[0]) / 256.0 + f64::from(eye.fraction_m.x);
            prop_assert!((back - x).abs() < 1e-6);
        }
    }
}
