//! The actions of a session: views and requests, and when they count as answered.

use super::Session;
use crate::dial::Dial;
use crate::expected::MAX_VIEWS_SLOW;
use crate::path::Pose;
use crate::schedule::{Action, Schedule};
use protocol::view::View;
use std::collections::VecDeque;
use tokio::time::Instant;

/// Attempts to find a chunk that no view brings.
const PROBE_TRIES: usize = 8;

/// Maximum of probes without an answer.
const MAX_PROBES: usize = 64;

/// Maximum of poses that wait for their views. Only a closed loop can exceed it; then the oldest is
/// dropped.
const MAX_POSES: usize = MAX_VIEWS_SLOW;

/// The first id of a view. A refusal names a request or a view by its id alone, so their ids must
/// differ; those of requests begin at 0.
const FIRST_VIEW: u32 = 1 << 31;

/// The view of a client at a pose: 1280 x 720, 60 degrees, 4 pixels of tolerance.
#[must_use]
pub fn view_of(id: u32, pose: &Pose, distance_m: u32) -> View {
    View {
        id,
        eye: pose.eye,
        velocity: pose.velocity,
        yaw_mdeg: pose.yaw_mdeg,
        pitch_mdeg: -10_000,
        fov_mdeg: 60_000,
        viewport: [1280, 720],
        tolerance_q4: 64,
        distance_m,
    }
}

/// Poses whose views are not settled, oldest first.
#[derive(Debug, Default)]
pub(super) struct Poses {
    next: u32,
    waiting: VecDeque<(u32, Instant)>,
}

impl Poses {
    /// Adds a pose with the time from which it counts. Returns the id for its view.
    fn begin(&mut self, since: Instant) -> u32 {
        let id = FIRST_VIEW.wrapping_add(self.next);
        // Ids only grow within a session; wrapping would take fifteen years.
        self.next = self.next.wrapping_add(1);
        if self.waiting.len() == MAX_POSES {
            self.waiting.pop_front();
        }
        self.waiting.push_back((id, since));
        id
    }

    /// Removes the poses that a settled view answers: its own and all older ones, whose views it
    /// replaced.
    fn settle(&mut self, view: u32) -> impl Iterator<Item = Instant> + use<> {
        let answered = self.waiting.partition_point(|(id, _)| *id <= view);
        self.waiting.drain(..answered).map(|(_, since)| since).collect::<Vec<_>>().into_iter()
    }

    pub(super) fn waiting_since(&self) -> impl Iterator<Item = Instant> {
        self.waiting.iter().map(|(_, since)| *since)
    }
}

impl<D: Dial> Session<'_, '_, D> {
    pub(super) fn perform(&mut self, action: Action, schedule: &mut Schedule) {
        match action {
            Action::View(since) => self.send_view(since, schedule.is_open()),
            Action::Probe(since) => self.probe(since, schedule),
            Action::Request(since, chunks) => self.request_chunks(since, chunks, schedule),
        }
    }

    /// Number of outstanding requests, and poses if these count.
    pub(super) fn outstanding(&self, with_poses: bool) -> usize {
        self.expected.open_requests() + if with_poses { self.poses.waiting.len() } else { 0 }
    }

    /// A view is complete, which answers its pose and all older ones.
    pub(super) fn settled(&mut self, view: u32, is_open: bool) {
        let (now, counters) = (Instant::now(), self.task.counters);
        counters.view_settled();
        for since in self.poses.settle(view) {
            let latency = now.saturating_duration_since(since);
            counters.settled(latency);
            if is_open {
                counters.answered(latency);
            }
        }
    }

    /// Sends the view of the pose at a time.
    fn send_view(&mut self, since: Instant, is_open: bool) {
        let pose = self.path.pose(&self.land, self.seconds(since));
        let view = view_of(self.poses.begin(since), &pose, self.task.config.view_distance_m);
        self.expected.add_view(&view);
        self.machine.set_view(view);
        if is_open {
            self.task.counters.request(since.elapsed());
        }
    }

    /// Requests one chunk ahead on the path that no view brings, to measure the latency.
    fn probe(&mut self, since: Instant, schedule: &mut Schedule) {
        if self.expected.open_requests() >= MAX_PROBES {
            self.task.counters.skipped();
            return;
        }
        let ahead_s = self.seconds(since) + 20.0;
        let candidate = (0..PROBE_TRIES)
            .map(|_| self.keys.key(schedule.next_number(), ahead_s))
            .find(|key| !self.resumption.held.contains(*key) && self.expected.can_request(*key));
        if let Some(key) = candidate {
            self.expected.add_request(self.machine.request(&[key]), key, since);
            self.task.counters.request(since.elapsed());
        }
    }

    /// Requests chunks by key, each with an id of its own, which a refusal names.
    fn request_chunks(&mut self, since: Instant, chunks: usize, schedule: &mut Schedule) {
        for _ in 0..chunks {
            let key = self.keys.key(schedule.next_number(), self.seconds(since));
            self.expected.add_request(self.machine.request(&[key]), key, since);
            self.task.counters.request(since.elapsed());
        }
    }

    /// Time on the path.
    fn seconds(&self, at: Instant) -> f64 {
        at.saturating_duration_since(self.task.epoch).as_secs_f64()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_settled_view_answers_its_pose_and_older_ones() {
        let now = Instant::now();
        let mut poses = Poses::default();
        let ids: Vec<u32> = (0..5).map(|_| poses.begin(now)).collect();
        assert_eq!(poses.settle(ids[2]).count(), 3);
        assert_eq!(poses.settle(ids[2]).count(), 0, "once");
        assert_eq!(poses.waiting_since().count(), 2);
        (0..2 * MAX_POSES).for_each(|_| _ = poses.begin(now));
        assert_eq!(poses.waiting_since().count(), MAX_POSES);
    }
}
