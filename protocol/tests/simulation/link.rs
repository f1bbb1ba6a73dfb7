//! One direction of a connection: frames arrive late and in order.

use bytes::Bytes;
use std::collections::VecDeque;

/// Frames in transit, with the times at which they arrive.
#[derive(Debug, Default)]
pub struct Link {
    frames: VecDeque<(u64, Bytes)>,
    /// Milliseconds from sending to arrival.
    latency: u64,
    /// Nothing arrives before.
    pub stalled_until: u64,
}

impl Link {
    pub fn new(latency: u64) -> Self {
        Self { latency, ..Self::default() }
    }

    /// Sends a frame. Returns when it arrives.
    pub fn send(&mut self, now: u64, frame: Bytes) -> u64 {
        let last = self.frames.back().map_or(0, |(at, _)| *at);
        let at = (now + self.latency).max(last).max(self.stalled_until);
        self.frames.push_back((at, frame));
        at
    }

    /// The next frame, if it has arrived.
    pub fn receive(&mut self, now: u64) -> Option<Bytes> {
        if self.next_arrival()? > now {
            return None;
        }
        self.frames.pop_front().map(|(_, frame)| frame)
    }

    /// When the next frame arrives.
    pub fn next_arrival(&self) -> Option<u64> {
        self.frames.front().map(|(at, _)| (*at).max(self.stalled_until))
    }

    pub fn len(&self) -> usize {
        self.frames.len()
    }
}
