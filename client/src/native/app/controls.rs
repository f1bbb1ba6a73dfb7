//! Keyboard and mouse control of the camera: flying, orbiting, and staying above the ground.

use crate::camera::{Fly, Orbit, Pose, Steering};
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
/// Least height above ground and sea, metres.
const CLEARANCE_M: f64 = 2.0;
/// Smallest orbit radius over land, metres.
const NEAREST_M: f64 = 100.0;
/// Flying speed and smallest orbit radius in an indoor scene, metres a second and metres.
const INDOORS: (f64, f64) = (2.5, 0.5);
/// Default orbit speed, degrees a second.
const ORBIT_DEG: f64 = 3.0;

/// The camera of the window and its controls.
#[derive(Debug)]
pub struct Controls {
    fly: Fly,
    orbit: Option<Orbit>,
    orbit_deg_per_s: f64,
    orbit_radius_m: f64,
    nearest_m: f64,
    /// Whether the camera stays above ground and sea.
    is_grounded: bool,
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

impl Controls {
    /// Starts at a pose; in orbit mode if a speed in degrees a second is given.
    #[must_use]
    pub fn new(pose: Pose, orbit_deg_per_s: Option<f64>, orbit_radius_m: f64) -> Self {
        Self {
            fly: Fly { pose, speed_m: START_SPEED_M },
            orbit: orbit_deg_per_s.map(|_| Orbit::through(&pose, orbit_radius_m)),
            orbit_deg_per_s: orbit_deg_per_s.unwrap_or(ORBIT_DEG),
            orbit_radius_m,
            nearest_m: NEAREST_M,
            is_grounded: true,
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
        self.fly.pose = pose;
        if self.orbit.is_some() {
            self.orbit = Some(Orbit::through(&pose, self.orbit_radius_m));
        }
    }

    /// Where the camera is.
    #[must_use]
    pub fn pose(&self) -> Pose {
        self.fly.pose
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

    /// Moves for `dt_s` seconds; `ground_m` is the height of the land below, if known.
    pub fn step(&mut self, dt_s: f64, ground_m: Option<f64>) {
        let axis = |plus: bool, minus: bool| f64::from(i8::from(plus) - i8::from(minus));
        let (turn_deg, tilt_deg) = std::mem::take(&mut self.turn);
        if let Some(orbit) = &mut self.orbit {
            orbit.bearing_deg += self.orbit_deg_per_s * dt_s + turn_deg;
            orbit.height_m += axis(self.held.up, self.held.down) * self.fly.speed_m * dt_s;
            orbit.radius_m -= axis(self.held.forward, self.held.back) * self.fly.speed_m * dt_s;
            orbit.radius_m = orbit.radius_m.clamp(self.nearest_m, 20_000.0);
            self.fly.pose = orbit.pose();
        } else {
            let steering = Steering {
                forward: axis(self.held.forward, self.held.back),
                right: axis(self.held.right, self.held.left),
                up: axis(self.held.up, self.held.down),
                turn_deg,
                tilt_deg,
            };
            let boost = if self.held.fast { BOOST } else { 1.0 };
            self.fly.step(&steering, dt_s * boost);
        }
        if !self.is_grounded {
            return;
        }
        let floor = ground_m.unwrap_or(0.0).max(0.0) + CLEARANCE_M;
        self.fly.pose.position_m.y = self.fly.pose.position_m.y.max(floor);
    }

    fn toggle_orbit(&mut self) {
        self.orbit = match self.orbit {
            Some(_) => None,
            None => Some(Orbit::through(&self.fly.pose, self.orbit_radius_m)),
        };
    }
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
        controls.step(1.0, None);
        let slow = -controls.pose().position_m.z;
        assert!((slow - START_SPEED_M).abs() < 1e-9);
        controls.key(KeyCode::ShiftLeft, ElementState::Pressed);
        controls.step(1.0, None);
        assert!((-controls.pose().position_m.z - slow - BOOST * START_SPEED_M).abs() < 1e-6);
        controls.release_all();
        let there = controls.pose();
        controls.step(1.0, None);
        assert_eq!(controls.pose(), there);
    }

    #[test]
    fn the_camera_stays_above_ground_and_sea() {
        let mut controls = controls();
        controls.key(KeyCode::KeyQ, ElementState::Pressed);
        controls.step(10.0, Some(40.0));
        assert_eq!(controls.pose().position_m.y, 42.0);
        controls.step(10.0, Some(-60.0));
        assert_eq!(controls.pose().position_m.y, 2.0);
    }

    #[test]
    fn indoors_the_camera_circles_closely_and_goes_under_the_floor() {
        let start: Pose = "0,4,13,0,-16".parse().unwrap();
        let mut controls = Controls::indoors(start, None, 13.6);
        controls.step(1.0, None);
        assert!(controls.is_orbiting() && (controls.pose().position_m - start.position_m).length() < 1e-6);
        controls.key(KeyCode::KeyQ, ElementState::Pressed);
        controls.step(4.0, None);
        assert!(controls.pose().position_m.y < 0.0, "{:?}", controls.pose());
    }

    #[test]
    fn dragging_to_the_right_turns_right_and_only_while_held() {
        let mut controls = controls();
        controls.pointer(10.0, 10.0);
        controls.pointer(20.0, 10.0);
        controls.step(0.0, None);
        assert_eq!(controls.pose().yaw_deg, 0.0);
        controls.button(MouseButton::Left, ElementState::Pressed);
        controls.pointer(120.0, 10.0);
        controls.step(0.0, None);
        assert!((controls.pose().yaw_deg - 15.0).abs() < 1e-9);
    }

    #[test]
    fn orbit_mode_circles_and_ends_where_it_is() {
        let mut controls = controls();
        controls.key(KeyCode::KeyO, ElementState::Pressed);
        controls.step(1.0, None);
        assert!(controls.is_orbiting() && controls.pose().position_m.x != 0.0);
        let there = controls.pose();
        controls.key(KeyCode::KeyO, ElementState::Pressed);
        controls.step(1.0, None);
        assert_eq!(controls.pose(), there);
    }
}
