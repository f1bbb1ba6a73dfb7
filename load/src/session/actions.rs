//! What a session says and asks when its agenda tells it to, and when that counts as answered.

use super::Session;
use crate::agenda::{Agenda, Errand};
use crate::dial::Dial;
use crate::interest::MAX_VIEWS_SLOW;
use crate::path::Pose;
use protocol::view::View;
use std::collections::VecDeque;
use tokio::time::Instant;

/// Tries to find a chunk that no view brings.
const PROBE_TRIES: usize = 8;

/// Probes without an answer at most.
const MAX_PROBES: usize = 64;

/// Poses whose views are waited for. When it is full, as only a closed loop can make it, the oldest
/// is forgotten.
const MAX_POSES: usize = MAX_VIEWS_SLOW;

/// The view that a client at a pose has: 1280 x 720 at 60 degrees, 4 pixels of tolerance.
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
    /// Notes a pose and since when it counts. Returns the id for its view.
    fn begin(&mut self, since: Instant) -> u32 {
        let id = self.next;
        // Ids only grow within a session; wrapping would take thirty years.
        self.next = self.next.wrapping_add(1);
        if self.waiting.len() == MAX_POSES {
            self.waiting.pop_front();
        }
        self.waiting.push_back((id, since));
        id
    }

    /// Takes those that a settled view answers: its own pose, and the older ones, whose views it
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
    pub(super) fn attend(&mut self, errand: Errand, agenda: &mut Agenda) {
        match errand {
            Errand::Look(since) => self.look(since, agenda.is_open()),
            Errand::Probe(since) => self.probe(since, agenda),
            Errand::Ask(since, chunks) => self.ask(since, chunks, agenda),
        }
    }

    /// What is outstanding: requests, and poses where these are waited for.
    pub(super) fn outstanding(&self, with_poses: bool) -> usize {
        self.interest.open_requests() + if with_poses { self.poses.waiting.len() } else { 0 }
    }

    /// A view is complete, and with it the poses up to its own.
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

    /// Says what is seen at a time.
    fn look(&mut self, since: Instant, is_open: bool) {
        let pose = self.path.pose(&self.land, self.seconds(since));
        let view = view_of(self.poses.begin(since), &pose, self.task.config.view_distance_m);
        self.interest.view(&view);
        self.machine.set_view(view);
        if is_open {
            self.task.counters.request(since.elapsed());
        }
    }

    /// Asks for one chunk near the path ahead that no view brings, to measure how long it takes.
    fn probe(&mut self, since: Instant, agenda: &mut Agenda) {
        if self.interest.open_requests() >= MAX_PROBES {
            return;
        }
        let ahead_s = self.seconds(since) + 20.0;
        let candidate = (0..PROBE_TRIES)
            .map(|_| self.keys.key(agenda.number(), ahead_s))
            .find(|key| self.interest.can_request(*key));
        if let Some(key) = candidate {
            self.interest.request(self.machine.request(&[key]), key, since);
            self.task.counters.request(since.elapsed());
        }
    }

    /// Asks for chunks by key. Each is a request of its own, so that each has an id to be refused
    /// by.
    fn ask(&mut self, since: Instant, chunks: usize, agenda: &mut Agenda) {
        for _ in 0..chunks {
            let key = self.keys.key(agenda.number(), self.seconds(since));
            self.interest.request(self.machine.request(&[key]), key, since);
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
    fn a_settled_view_answers_its_pose_and_the_older_ones() {
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
