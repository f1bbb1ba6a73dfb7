//! The generation service of the simulated server: one job for each chunk, however many sessions
//! wait for it, in a bounded queue, on two threads.

use crate::plant::Plant;
use protocol::Delivery;
use protocol::server::ChunkRequest;
use terrain::ChunkKey;
use test_support::Random;

/// Jobs that wait or run. A request beyond it is refused as overloaded.
pub const MAX_JOBS: usize = 48;

const THREADS: usize = 2;

/// One job, with everyone who waits for it.
#[derive(Debug)]
struct Job {
    number: u64,
    key: ChunkKey,
    delivery: Delivery,
    is_running: bool,
    waiters: Vec<(u32, ChunkRequest)>,
}

/// A finished job.
pub struct Done {
    pub key: ChunkKey,
    pub delivery: Delivery,
    pub waiters: Vec<(u32, ChunkRequest)>,
}

#[derive(Debug, Default)]
pub struct Generation {
    jobs: Vec<Job>,
    next: u64,
}

impl Generation {
    /// The service of a restarted server: no jobs, and numbers that were not used before.
    pub fn restarted(before: &Self) -> Self {
        Self { jobs: Vec::new(), next: before.next }
    }

    /// Requests a chunk for a session; false if the queue is full.
    pub fn request(&mut self, session: u32, request: ChunkRequest, delivery: Delivery, plant: Plant) -> bool {
        let same = |job: &&mut Job| job.key == request.key && job.delivery == delivery;
        if plant != Plant::TwoJobs
            && let Some(job) = self.jobs.iter_mut().find(same)
        {
            job.waiters.push((session, request));
            return true;
        }
        if self.jobs.len() >= MAX_JOBS {
            return false;
        }
        self.next += 1;
        self.jobs.push(Job {
            number: self.next,
            key: request.key,
            delivery,
            is_running: false,
            waiters: vec![(session, request)],
        });
        true
    }

    /// Starts waiting jobs on free threads. Returns their numbers and durations.
    pub fn start(&mut self, random: &mut Random, slowness: u64) -> Vec<(u64, u64)> {
        let mut free = THREADS.saturating_sub(self.jobs.iter().filter(|job| job.is_running).count());
        let mut started = Vec::new();
        for job in &mut self.jobs {
            if free == 0 {
                break;
            }
            if !job.is_running {
                job.is_running = true;
                free -= 1;
                started.push((job.number, random.ms(1..8) * slowness));
            }
        }
        started
    }

    /// Ends a running job; none if the server was restarted since.
    pub fn finish(&mut self, number: u64) -> Option<Done> {
        let index = self.jobs.iter().position(|job| job.number == number)?;
        let Job { key, delivery, waiters, .. } = self.jobs.remove(index);
        Some(Done { key, delivery, waiters })
    }

    /// Removes a session's requests of a chunk whose job has not begun. Returns them.
    pub fn cancel(&mut self, session: u32, key: ChunkKey) -> Vec<ChunkRequest> {
        let mut cancelled = Vec::new();
        for job in self.jobs.iter_mut().filter(|job| job.key == key && !job.is_running) {
            job.waiters.retain(|(waiter, request)| {
                if *waiter == session {
                    cancelled.push(*request);
                }
                *waiter != session
            });
        }
        self.jobs.retain(|job| job.is_running || !job.waiters.is_empty());
        cancelled
    }

    /// Whether two jobs of one chunk and delivery exist.
    pub fn has_duplicate(&self) -> bool {
        self.jobs.iter().enumerate().any(|(index, job)| {
            self.jobs[..index].iter().any(|other| other.key == job.key && other.delivery == job.delivery)
        })
    }

    pub fn len(&self) -> usize {
        self.jobs.len()
    }
}
