//! Measurements of a run: the JSON of `--stats` and the numbers of the panel.

use serde::Serialize;
use std::collections::VecDeque;
use std::time::Duration;

/// Times of the latest frames.
#[derive(Clone, Debug, Default)]
pub struct FrameTimes {
    times: VecDeque<Duration>,
}

/// Window of the quantiles, frames.
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

    /// Whether there are no frames.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.times.is_empty()
    }

    /// Quantile `q` (0 to 1) of the latest `window` frame times, milliseconds; 0 without frames.
    #[must_use]
    pub fn quantile_ms(&self, q: f64, window: usize) -> f64 {
        let mut sorted: Vec<Duration> = self.times.iter().rev().take(window).copied().collect();
        sorted.sort_unstable();
        // Nearest rank: a quantile is a measured time.
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
    /// Draw calls of the land in the last frame.
    pub terrain_draws: u32,
    /// Clumps of grass and trees drawn in the last frame.
    pub plants_drawn: u32,
    /// Clumps dropped for lack of capacity.
    pub plants_lost: u32,
    /// Blocks of plants dropped for lack of capacity, with all their clumps.
    pub plant_blocks_lost: u32,
    /// GPU bytes of one more chunk.
    pub gpu_bytes_per_chunk: u64,
    /// Delivery mode: `exact`, `refined`, `seed` or `quantised`; `none` in a local scene.
    pub delivery: &'static str,
    /// Bytes of frames received.
    pub bytes_received: u64,
    /// Chunks from the server that were wrong or not asked for.
    pub bad_chunks: u64,
    /// Chunks that the server refused.
    pub refused_chunks: u64,
    /// Requests for bad and refused chunks.
    pub retried_chunks: u64,
    /// Times that a failed GPU was replaced by a new one.
    pub gpu_rebuilds: u32,
    /// From the start of the program to the first chunk.
    pub seconds_to_first_chunk: Option<f64>,
    /// From the start of the program to the first complete view.
    pub seconds_to_complete_view: Option<f64>,
    /// From the start of the program to the first image: in a headless run after the complete view
    /// and the creation of the renderer.
    pub seconds_to_first_picture: Option<f64>,
    /// Median frame time, milliseconds, of the latest frames that are kept: of a shot until the GPU
    /// is done, in a window from frame to frame.
    pub frame_ms_p50: f64,
    /// The 99th percentile of the same.
    pub frame_ms_p99: f64,
    /// Chunks in memory.
    pub chunks_resident: usize,
    /// Memory of the slots in use, CPU and GPU together.
    pub chunk_bytes_resident: usize,
    /// Memory of all slots: the budget.
    pub chunk_bytes_budget: usize,
    /// The tolerance in use: above the requested one if the budget is too small.
    pub tolerance_px: f64,
    /// The last frame's camera in the format of `--camera`: above the requested one if that was
    /// underground.
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
