//! Keyboard and mouse control of the camera: flying, orbiting, and staying above the ground.

use crate::camera::{CLEARANCE_M, Fly, Orbit, Pose, Steering};
use terrain::constants::UNITS_PER_METRE;
use winit::event::{ElementState, MouseButton, MouseScrollDelta};
use winit::keyboard::KeyCode;

/// Initial flying speed, metres a second.
const START_SPEED_M: f64 = 120.0;
/// Range of the flying speed.
const SPEED_M: std::ops::RangeInclusive<f64> = 0.5..=5000.0;
/// Shift multiplies the speed by this.
const BOOST: f64 = 5.0;
/// One notch of the wheel multiplies the speed by this.
const NOTCH: f64 = 1.25;
/// Degrees of turn for one pixel of drag.
const DRAG_DEG: f64 = 0.15;
/// Smallest orbit radius over land, metres; less where the scene's own radius is less.
const NEAREST_M: f64 = 100.0;
/// Flying speed and smallest orbit radius in an indoor scene, metres a second and metres.
const INDOORS: (f64, f64) = (2.5, 0.5);
/// Default orbit speed, degrees a second.
const ORBIT_DEG: f64 = 3.0;

/// The camera of the window and its controls.
#[derive(Debug)]
pub struct Controls {
    /// With the requested pose: coarse land that covers it raises the eye until finer land arrives.
    fly: Fly,
    /// Least height of the eye over the land below it, metres.
    floor_m: f64,
    orbit: Option<Orbit>,
    orbit_deg_per_s: f64,
    orbit_radius_m: f64,
    nearest_m: f64,
    /// Whether the camera stays above the ground.
    is_grounded: bool,
    /// Whether the user has moved the camera since its start.
    has_moved: bool,
    held: Held,
    dragging: bool,
    cursor: Option<(f64, f64)>,
    turn: (f64, f64),
}

/// Keys that are down.
#[derive(Debug, Default)]
struct Held {
    forward: bool,
    back: bool,
    left: bool,
    right: bool,
    up: bool,
    down: bool,
    fast: bool,
}

impl Held {
    /// Forward, to the right and up, each -1 to 1.
    fn axes(&self) -> [f64; 3] {
        let axis = |plus: bool, minus: bool| f64::from(i8::from(plus) - i8::from(minus));
        [axis(self.forward, self.back), axis(self.right, self.left), axis(self.up, self.down)]
    }
}

impl Controls {
    /// Starts at a pose; in orbit mode if a speed in degrees a second is given.
    #[must_use]
    pub fn new(pose: Pose, orbit_deg_per_s: Option<f64>, orbit_radius_m: f64) -> Self {
        Self {
            fly: Fly { pose, speed_m: START_SPEED_M },
            floor_m: f64::MIN,
            orbit: orbit_deg_per_s.map(|_| Orbit::through(&pose, orbit_radius_m)),
            orbit_deg_per_s: orbit_deg_per_s.unwrap_or(ORBIT_DEG),
            orbit_radius_m,
            nearest_m: NEAREST_M.min(orbit_radius_m),
            is_grounded: true,
            has_moved: false,
            held: Held::default(),
            dragging: false,
            cursor: None,
            turn: (0.0, 0.0),
        }
    }

    /// [`Controls::new`] in an indoor scene: slower, closer, and allowed below the floor. Orbits
    /// from the start, with speed 0 by default.
    #[must_use]
    pub fn indoors(pose: Pose, orbit_deg_per_s: Option<f64>, orbit_radius_m: f64) -> Self {
        let mut controls = Self::new(pose, Some(orbit_deg_per_s.unwrap_or(0.0)), orbit_radius_m);
        (controls.fly.speed_m, controls.nearest_m) = INDOORS;
        controls.is_grounded = false;
        controls
    }

    /// Moves the camera; an orbit goes on around the point that it then looks towards.
    pub fn move_to(&mut self, pose: Pose) {
        (self.fly.pose, self.floor_m, self.has_moved) = (pose, f64::MIN, true);
        if self.orbit.is_some() {
            self.orbit = Some(Orbit::through(&pose, self.orbit_radius_m));
        }
    }

    /// [`Controls::move_to`] a start, from which the user has not moved.
    pub fn start_at(&mut self, pose: Pose) {
        self.move_to(pose);
        self.has_moved = false;
    }

    /// Whether the user has moved the camera since its start.
    #[must_use]
    pub fn has_moved(&self) -> bool {
        self.has_moved
    }

    /// Where the camera is: at its requested pose, or above it on the land that covers that.
    #[must_use]
    pub fn pose(&self) -> Pose {
        lifted(self.fly.pose, self.floor_m)
    }

    /// Flying speed, metres a second.
    #[must_use]
    pub fn speed_m(&self) -> f64 {
        self.fly.speed_m
    }

    /// Whether the camera orbits.
    #[must_use]
    pub fn is_orbiting(&self) -> bool {
        self.orbit.is_some()
    }

    /// A key went down or up.
    pub fn key(&mut self, code: KeyCode, state: ElementState) {
        let down = state == ElementState::Pressed;
        match code {
            KeyCode::KeyW | KeyCode::ArrowUp => self.held.forward = down,
            KeyCode::KeyS | KeyCode::ArrowDown => self.held.back = down,
            KeyCode::KeyA | KeyCode::ArrowLeft => self.held.left = down,
            KeyCode::KeyD | KeyCode::ArrowRight => self.held.right = down,
            KeyCode::KeyE => self.held.up = down,
            KeyCode::KeyQ => self.held.down = down,
            KeyCode::ShiftLeft | KeyCode::ShiftRight => self.held.fast = down,
            KeyCode::KeyO if down => self.toggle_orbit(),
            _ => {}
        }
        self.has_moved |= self.held.axes() != [0.0; 3];
    }

    /// A mouse button went down or up: dragging turns the camera.
    pub fn button(&mut self, button: MouseButton, state: ElementState) {
        if matches!(button, MouseButton::Left | MouseButton::Right) {
            self.dragging = state == ElementState::Pressed;
        }
    }

    /// The pointer moved, pixels.
    pub fn pointer(&mut self, x: f64, y: f64) {
        if let (true, Some((x0, y0))) = (self.dragging, self.cursor) {
            self.turn.0 += (x - x0) * DRAG_DEG;
            self.turn.1 -= (y - y0) * DRAG_DEG;
            self.has_moved = true;
        }
        self.cursor = Some((x, y));
    }

    /// The wheel turned: faster or slower.
    pub fn wheel(&mut self, delta: MouseScrollDelta) {
        let notches = match delta {
            MouseScrollDelta::LineDelta(_, lines) => f64::from(lines),
            MouseScrollDelta::PixelDelta(pixels) => pixels.y / 40.0,
        };
        self.fly.speed_m = (self.fly.speed_m * NOTCH.powf(notches)).clamp(*SPEED_M.start(), *SPEED_M.end());
    }

    /// The window lost the keyboard focus: key releases will be missed.
    pub fn release_all(&mut self) {
        self.held = Held::default();
        self.dragging = false;
    }

    /// Moves for `dt_s` seconds. `ground` is the height of the land below a pose, units, if known;
    /// `is_settled` is whether all of it has arrived.
    pub fn step(&mut self, dt_s: f64, is_settled: bool, ground: impl Fn(&Pose) -> Option<i32>) {
        let is_grounded = self.is_grounded;
        let floor_under = |pose: &Pose| floor_m(ground(pose).filter(|_| is_grounded));
        let (turn_deg, tilt_deg) = std::mem::take(&mut self.turn);
        let [forward, right, up] = self.held.axes();
        if let Some(orbit) = &mut self.orbit {
            let way_m = self.fly.speed_m * dt_s * if self.held.fast { BOOST } else { 1.0 };
            orbit.bearing_deg += self.orbit_deg_per_s * dt_s + turn_deg;
            orbit.tilt(tilt_deg);
            orbit.height_m += up * way_m;
            orbit.radius_m -= forward * way_m;
            orbit.radius_m = orbit.radius_m.clamp(self.nearest_m, 20_000.0);
            self.fly.pose = orbit.pose();
        } else {
            let is_moving = [forward, right, up] != [0.0; 3];
            if is_moving && (is_settled || up > 0.0) {
                // No finer land lets the eye down, or the user wants it higher than it is.
                self.fly.pose = lifted(self.fly.pose, floor_under(&self.fly.pose));
            }
            let height_m = self.fly.pose.position_m.y;
            let depth_m = (floor_under(&self.fly.pose) - height_m).max(0.0);
            let boost = if self.held.fast { BOOST } else { 1.0 };
            self.fly.step(&Steering { forward, right, up, turn_deg, tilt_deg }, dt_s * boost);
            if is_moving {
                // No deeper in the land than before, and into the sea only by the key for down.
                let is_dry = is_grounded && height_m >= CLEARANCE_M && up >= 0.0;
                let land_m = floor_under(&self.fly.pose) - depth_m;
                let lowest_m = if is_dry { land_m.max(CLEARANCE_M) } else { land_m };
                self.fly.pose = lifted(self.fly.pose, lowest_m);
            }
        }
        self.floor_m = floor_under(&self.fly.pose);
    }

    fn toggle_orbit(&mut self) {
        self.fly.pose = self.pose();
        self.orbit = match self.orbit {
            Some(_) => None,
            None => Some(Orbit::through(&self.fly.pose, self.orbit_radius_m)),
        };
    }
}

/// Least height of an eye over ground of a height (units), metres.
fn floor_m(ground: Option<i32>) -> f64 {
    ground.map_or(f64::MIN, |units| f64::from(units) / f64::from(UNITS_PER_METRE) + CLEARANCE_M)
}

/// The pose raised to a least height, metres.
fn lifted(pose: Pose, floor_m: f64) -> Pose {
    Pose { position_m: pose.position_m.with_y(pose.position_m.y.max(floor_m)), ..pose }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn controls() -> Controls {
        Controls::new("0,100,0,0,0".parse().unwrap(), None, 1000.0)
    }

    #[test]
    fn keys_move_and_shift_moves_faster() {
        let mut controls = controls();
        controls.key(KeyCode::KeyW, ElementState::Pressed);
        controls.step(1.0, true, |_| None);
        let slow = -controls.pose().position_m.z;
        assert!((slow - START_SPEED_M).abs() < 1e-9);
        controls.key(KeyCode::ShiftLeft, ElementState::Pressed);
        controls.step(1.0, true, |_| None);
        assert!((-controls.pose().position_m.z - slow - BOOST * START_SPEED_M).abs() < 1e-6);
        controls.release_all();
        let there = controls.pose();
        controls.step(1.0, true, |_| None);
        assert_eq!(controls.pose(), there);
    }

    /// Land of one height, metres.
    fn land(height_m: i32) -> impl Fn(&Pose) -> Option<i32> {
        move |_| Some(height_m * 256)
    }

    #[test]
    fn the_camera_stays_above_ground_and_goes_into_the_sea_by_a_key_only() {
        let mut controls = controls();
        controls.key(KeyCode::KeyQ, ElementState::Pressed);
        controls.step(10.0, true, land(40));
        assert_eq!(controls.pose().position_m.y, 40.5);
        controls.step(10.0, true, land(-60));
        assert_eq!(controls.pose().position_m.y, -59.5);
        controls.move_to("0,10,0,0,-45".parse().unwrap());
        controls.release_all();
        controls.key(KeyCode::KeyW, ElementState::Pressed);
        controls.step(10.0, true, land(-60));
        assert_eq!(controls.pose().position_m.y, CLEARANCE_M);
    }

    #[test]
    fn coarse_land_lifts_the_camera_until_finer_land_arrives() {
        let mut controls = controls();
        let height = |controls: &Controls| controls.pose().position_m.y;
        controls.step(0.1, false, land(150));
        assert_eq!(height(&controls), 150.5);
        controls.step(0.1, true, land(90));
        assert_eq!(height(&controls), 100.0);
        // Also if it flies on in the meantime, over land that is 4 m higher.
        controls.key(KeyCode::KeyW, ElementState::Pressed);
        controls.step(0.1, false, land(150));
        let rising = |pose: &Pose| land(if pose.position_m.z < -20.0 { 154 } else { 150 })(pose);
        controls.step(0.1, false, rising);
        assert_eq!(height(&controls), 154.5);
        controls.step(0.1, true, land(90));
        assert_eq!(height(&controls), 104.0);
    }

    #[test]
    fn flying_over_a_hill_keeps_its_height_and_rising_starts_at_the_eye() {
        let mut controls = controls();
        controls.key(KeyCode::KeyW, ElementState::Pressed);
        for hill_m in [90, 150, 90] {
            controls.step(0.1, true, land(hill_m));
        }
        assert_eq!(controls.pose().position_m.y, 150.5);
        controls.release_all();
        controls.key(KeyCode::KeyE, ElementState::Pressed);
        controls.step(0.1, false, land(200));
        assert!((controls.pose().position_m.y - 212.5).abs() < 1e-9, "{:?}", controls.pose());
    }

    #[test]
    fn keys_drags_and_places_move_and_a_start_and_the_wheel_do_not() {
        let start: Pose = "0,100,0,0,0".parse().unwrap();
        let mut controls = controls();
        controls.pointer(1.0, 1.0);
        controls.pointer(2.0, 2.0);
        controls.key(KeyCode::KeyO, ElementState::Pressed);
        controls.step(1.0, true, |_| None);
        assert!(controls.pose() != start && !controls.has_moved(), "it circles by itself");
        controls.wheel(MouseScrollDelta::LineDelta(0.0, 1.0));
        assert!(!controls.has_moved(), "it sets the speed");
        let moves: [fn(&mut Controls); 3] = [
            |controls| controls.key(KeyCode::KeyA, ElementState::Pressed),
            |controls| {
                controls.button(MouseButton::Left, ElementState::Pressed);
                controls.pointer(9.0, 9.0);
            },
            |controls| controls.move_to("0,50,0,0,0".parse().unwrap()),
        ];
        for moves in moves {
            moves(&mut controls);
            assert!(controls.has_moved());
            controls.release_all();
            controls.start_at(start);
            assert!(!controls.has_moved());
        }
    }

    #[test]
    fn indoors_the_camera_circles_closely_and_goes_under_the_floor() {
        let start: Pose = "0,4,13,0,-16".parse().unwrap();
        let mut controls = Controls::indoors(start, None, 13.6);
        controls.step(1.0, true, |_| None);
        assert!(controls.is_orbiting() && (controls.pose().position_m - start.position_m).length() < 1e-6);
        controls.key(KeyCode::KeyQ, ElementState::Pressed);
        controls.step(4.0, true, |_| None);
        assert!(controls.pose().position_m.y < 0.0, "{:?}", controls.pose());
    }

    #[test]
    fn dragging_to_the_right_turns_right_and_only_while_held() {
        let mut controls = controls();
        controls.pointer(10.0, 10.0);
        controls.pointer(20.0, 10.0);
        controls.step(0.0, true, |_| None);
        assert_eq!(controls.pose().yaw_deg, 0.0);
        controls.button(MouseButton::Left, ElementState::Pressed);
        controls.pointer(120.0, 10.0);
        controls.step(0.0, true, |_| None);
        assert!((controls.pose().yaw_deg - 15.0).abs() < 1e-9);
    }

    #[test]
    fn orbit_mode_circles_and_ends_where_it_is() {
        let mut controls = controls();
        controls.key(KeyCode::KeyO, ElementState::Pressed);
        controls.step(1.0, true, |_| None);
        assert!(controls.is_orbiting() && controls.pose().position_m.x != 0.0);
        let there = controls.pose();
        controls.key(KeyCode::KeyO, ElementState::Pressed);
        controls.step(1.0, true, |_| None);
        assert_eq!(controls.pose(), there);
    }
}
