//! What a run measured: the JSON of `--stats` and the numbers of the panel.

use serde::Serialize;
use std::collections::VecDeque;
use std::time::Duration;

/// Times of the latest frames.
#[derive(Clone, Debug, Default)]
pub struct FrameTimes {
    times: VecDeque<Duration>,
}

/// Frames that the quantiles look back on.
const WINDOW: usize = 4096;

impl FrameTimes {
    /// Adds a frame.
    pub fn push(&mut self, time: Duration) {
        if self.times.len() == WINDOW {
            self.times.pop_front();
        }
        self.times.push_back(time);
    }

    /// Number of frames, at most 4096.
    #[must_use]
    pub fn len(&self) -> usize {
        self.times.len()
    }

    /// Whether no frame was added.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.times.is_empty()
    }

    /// The time in milliseconds that a share `q` (0 to 1) of the latest `window` frames did not
    /// exceed; 0 without frames.
    #[must_use]
    pub fn quantile_ms(&self, q: f64, window: usize) -> f64 {
        let mut sorted: Vec<Duration> = self.times.iter().rev().take(window).copied().collect();
        sorted.sort_unstable();
        // Nearest rank: a quantile is a time that was really measured.
        let rank = (q * sorted.len() as f64).ceil() as usize;
        sorted.get(rank.saturating_sub(1)).map_or(0.0, |time| time.as_secs_f64() * 1000.0)
    }
}

/// The record that `--stats` writes. Field names are a contract with scripts.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stats {
    /// Name and backend of the GPU.
    pub adapter: String,
    /// Frames timed.
    pub frames: usize,
    /// Chunks drawn in the last frame.
    pub chunks_drawn: usize,
    /// Triangles sent in the last frame.
    pub triangles: u64,
    /// Draw calls that the land of the last frame took.
    pub terrain_draws: u32,
    /// Clumps of grass and trees drawn in the last frame.
    pub plants_drawn: u32,
    /// Those left out of it for want of room.
    pub plants_lost: u32,
    /// Bytes on the GPU that one more chunk takes.
    pub gpu_bytes_per_chunk: u64,
    /// How chunks came: `exact` or `seed`; `none` in a local scene.
    pub delivery: &'static str,
    /// Bytes of frames received.
    pub bytes_received: u64,
    /// From the start of the program to the first chunk.
    pub seconds_to_first_chunk: Option<f64>,
    /// From the start of the program until the view had all its detail.
    pub seconds_to_complete_view: Option<f64>,
    /// From the start of the program until the first picture was drawn: the view and, in a shot,
    /// after it the renderer with its materials.
    pub seconds_to_first_picture: Option<f64>,
    /// Median time of a frame, until the GPU was done with it.
    pub frame_ms_p50: f64,
    /// The 99th percentile of the same.
    pub frame_ms_p99: f64,
    /// Chunks in memory.
    pub chunks_resident: usize,
    /// Memory of the slots in use, CPU and GPU together.
    pub chunk_bytes_resident: usize,
    /// Memory of all slots: the bound.
    pub chunk_bytes_budget: usize,
    /// The tolerance that was drawn with: above the one asked for if the budget was too small for
    /// it.
    pub tolerance_px: f64,
    /// The last frame's camera as `--camera` takes it: above the one asked for if that was in the
    /// ground.
    pub camera: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_measured_times_of_the_latest_frames() {
        let mut times = FrameTimes::default();
        assert_eq!(times.quantile_ms(0.5, 100), 0.0);
        for ms in 1..=100 {
            times.push(Duration::from_millis(ms));
        }
        assert_eq!((times.quantile_ms(0.5, 100), times.quantile_ms(0.99, 100)), (50.0, 99.0));
        assert_eq!(times.quantile_ms(1.0, 100), 100.0);
        assert_eq!(times.quantile_ms(0.0, 10), 91.0, "the window holds the latest");
    }
}
