//! Child processes that must neither hang nor stay.

use std::process::Child;
use std::time::{Duration, Instant};

/// Pause between looks at a child.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// A child that is killed and collected when this is dropped.
#[derive(Debug)]
pub struct Guarded(pub Child);

impl Guarded {
    /// Waits until the child has ended by itself; false if it runs on at the deadline.
    ///
    /// # Errors
    /// It cannot be asked.
    pub fn ends_before(&mut self, deadline: Instant) -> std::io::Result<bool> {
        loop {
            if self.0.try_wait()?.is_some() {
                return Ok(true);
            }
            if Instant::now() >= deadline {
                return Ok(false);
            }
            std::thread::sleep(LOOK_EVERY);
        }
    }
}

impl Drop for Guarded {
    fn drop(&mut self) {
        // Both fail only where the child has ended and been collected.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
