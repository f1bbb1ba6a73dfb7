//! The window: winit's event loop. What happens in the window is in [`window_state`].

pub mod capture;
pub mod clock;
pub mod controls;
pub mod keys;
pub mod notices;
pub mod overlay;
pub mod panel;
pub mod panel_settings;
pub mod view_settings;
pub mod window_state;

use crate::native::args::Args;
use crate::native::screenshot::{check_output, write_stats};
use anyhow::{Context as _, anyhow};
use std::time::Instant;
use window_state::{FrameOutcome, WindowState};
use winit::application::ApplicationHandler;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, OwnedDisplayHandle};
use winit::window::WindowId;

/// Opens the window and runs until it is closed.
pub fn run(args: &Args, started: Instant) -> anyhow::Result<()> {
    args.stats.as_deref().map_or(Ok(()), |path| check_output("--stats", path))?;
    let event_loop = EventLoop::new().map_err(|error| {
        // Of several lines: the first one states the cause, without a display and without a
        // library.
        let error = error.to_string();
        let cause = error.lines().next().unwrap_or_default();
        anyhow!(
            "cannot open a window ({cause}): set DISPLAY or WAYLAND_DISPLAY to a display, install its \
             libraries, or draw into a file with --shot FILE.png"
        )
    })?;
    let mut app = App {
        args: args.clone(),
        started,
        display: event_loop.owned_display_handle(),
        window: None,
        failure: None,
    };
    event_loop.run_app(&mut app).context("the window system failed")?;
    let stats = app.window.as_ref().map(WindowState::stats);
    if let Some(failure) = app.failure {
        return Err(failure);
    }
    if let (Some(path), Some(stats)) = (&args.stats, &stats) {
        write_stats(path, stats)?;
    }
    Ok(())
}

struct App {
    args: Args,
    started: Instant,
    display: OwnedDisplayHandle,
    window: Option<WindowState>,
    failure: Option<anyhow::Error>,
}

impl ApplicationHandler for App {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.window.is_some() {
            return;
        }
        match WindowState::start(event_loop, self.display.clone(), &self.args, self.started) {
            Ok(window) => self.window = Some(window),
            Err(error) => self.quit(event_loop, Some(error)),
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(window) = &mut self.window else { return };
        if matches!(event, WindowEvent::RedrawRequested) {
            match window.redraw() {
                Ok(FrameOutcome::Continue) => {}
                Ok(FrameOutcome::Quit) => self.quit(event_loop, None),
                Err(error) => self.quit(event_loop, Some(error)),
            }
        } else if window.event(&event) {
            self.quit(event_loop, None);
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        let Some(window) = &self.window else { return };
        let resume_at = window.resume_at();
        if Instant::now() >= resume_at {
            window.request_redraw();
            // The window system asks for the frame when it is time, which wakes the loop.
            event_loop.set_control_flow(ControlFlow::Wait);
        } else {
            event_loop.set_control_flow(ControlFlow::WaitUntil(resume_at));
        }
    }
}

impl App {
    fn quit(&mut self, event_loop: &ActiveEventLoop, failure: Option<anyhow::Error>) {
        self.failure = self.failure.take().or(failure);
        event_loop.exit();
    }
}
