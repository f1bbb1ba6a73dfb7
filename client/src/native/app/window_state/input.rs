//! Events of the window: keys, pointer, places.

use super::{NOTICE_DURATION, WindowState};
use crate::native::app::keys::{self, Action};
use crate::scene::places::PlaceFinder;
use std::time::{Duration, Instant};
use winit::event::{ElementState, WindowEvent};
use winit::keyboard::{Key, PhysicalKey};
use winit::window::Fullscreen;

/// Time for the search of places in a frame; an eighth of frames that take longer.
const SEARCH: Duration = Duration::from_millis(3);

impl WindowState {
    /// Takes an event; true to quit.
    pub fn event(&mut self, event: &WindowEvent) -> bool {
        // As it was before the event: Esc takes the focus from a text field.
        let is_typing = self.has_overlay && self.overlay.is_typing();
        // A hidden panel takes nothing, but must not miss a release or where the pointer is.
        let taken = self.overlay.takes(&self.window, event) && self.has_overlay;
        match event {
            WindowEvent::CloseRequested => return true,
            WindowEvent::Resized(size) => self.surface.resize(&self.gpu, (size.width, size.height)),
            WindowEvent::Focused(false) => self.controls.release_all(),
            WindowEvent::ModifiersChanged(modifiers) => self.modifiers = modifiers.state(),
            WindowEvent::KeyboardInput { event: key, .. } => {
                let PhysicalKey::Code(code) = key.physical_key else { return false };
                let is_pressed = key.state == ElementState::Pressed;
                let text = if let Key::Character(text) = &key.logical_key { text.as_str() } else { "" };
                let action = keys::action(code, text, self.modifiers.control_key(), is_typing);
                match action.filter(|_| is_pressed && !key.repeat) {
                    Some(action) => return self.act(action),
                    // Key releases always pass, or a key would stay down under the panel.
                    None if key.repeat || (taken && is_pressed) => {}
                    None => self.controls.key(code, key.state),
                }
            }
            WindowEvent::MouseInput { state, button, .. } if !taken || *state == ElementState::Released => {
                self.controls.button(*button, *state);
            }
            WindowEvent::CursorMoved { position, .. } => self.controls.pointer(position.x, position.y),
            WindowEvent::MouseWheel { delta, .. } if !taken => self.controls.wheel(*delta),
            _ => {}
        }
        false
    }

    /// Does what a key is for; true to quit.
    fn act(&mut self, action: Action) -> bool {
        let now = Instant::now();
        match action {
            Action::Quit => return true,
            Action::AskQuit => return self.notices.is_second_escape(now),
            Action::Fullscreen => {
                let is_full = self.window.fullscreen().is_some();
                self.window.set_fullscreen((!is_full).then_some(Fullscreen::Borderless(None)));
            }
            Action::Screenshot => self.takes_screenshot = true,
            Action::Pause => {
                self.clock.is_paused = !self.clock.is_paused;
                let line =
                    if self.clock.is_paused { "time paused; press Space to resume" } else { "time goes on" };
                self.notices.show(line, now, NOTICE_DURATION);
            }
            Action::ResetView => {
                self.wanted = None;
                self.narrow_view();
                self.controls.start_at(self.start_pose);
            }
            Action::Help => self.show_keys = !self.show_keys,
            Action::Panel => {
                self.show_panel = !self.show_panel;
                if !self.show_panel {
                    self.notices.show("F1 shows the panel", now, 2 * NOTICE_DURATION);
                }
            }
            Action::Go(_) if self.args.scene.is_local() => {
                self.notices.show("this scene has no places", now, NOTICE_DURATION);
            }
            Action::Go(place) => self.wanted = Some(place),
        }
        false
    }

    /// Searches places for a small part of a frame, and goes to the wanted one.
    pub(super) fn visit(&mut self, step: Duration) {
        let Some(land) = self.streamer.cache().land() else { return };
        let scale = self.args.vertical_scale();
        let finder = self.places.get_or_insert_with(|| PlaceFinder::new(*land, scale));
        let begun = Instant::now();
        let longest = SEARCH.max(step / 8);
        while begun.elapsed() < longest && !finder.advance() {}
        let Some(place) = self.wanted else { return };
        if let Some(pose) = finder.get(place) {
            self.wanted = None;
            self.narrow_view();
            let needed_m = place.view_distance_m();
            if needed_m > self.settings.view_distance_m && self.args.view_distance.is_none() {
                self.view_distance_before_place_m = Some(self.settings.view_distance_m);
                self.settings.view_distance_m = needed_m;
            }
            self.controls.move_to(pose);
            self.notices.show(place.label(), Instant::now(), NOTICE_DURATION);
        } else {
            let line = format!("searching: {}", place.label());
            self.notices.show(&line, Instant::now(), NOTICE_DURATION);
        }
    }

    /// Ends the widening of the view by a place.
    fn narrow_view(&mut self) {
        if let Some(view_distance_m) = self.view_distance_before_place_m.take() {
            self.settings.view_distance_m = view_distance_m;
        }
    }
}
