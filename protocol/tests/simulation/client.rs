//! A simulated client: what it wants, what it holds, and its connection.

use crate::ledger::{FIRST_INVALID, FIRST_VIEW, Ledger};
use crate::plant::Plant;
use crate::truth;
use bytes::Bytes;
use protocol::backoff::Backoff;
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::limits::MAX_KEYS;
use protocol::message::{ClientMessage, WireKey};
use protocol::view::View;
use protocol::{DataFrame, Delivery, control};
use std::collections::BTreeSet;
use std::time::Duration;
use terrain::ChunkKey;
use test_support::Random;

/// Half the side of the square in which clients move, metres.
const RANGE_M: i64 = 300;

/// Keys of one message with invalid keys.
const INVALID_KEYS: i32 = 400;

#[derive(Debug)]
pub struct Client {
    delivery: Delivery,
    window: u32,
    backoff: Backoff,
    held: BTreeSet<ChunkKey>,
    view: Option<View>,
    next_view: u32,
    next_invalid: u32,
    /// Requests by key so far on this connection.
    requests: u32,
    session: Option<(ClientSession, Ledger)>,
    /// Of the present view: it was reported complete.
    is_settled: bool,
    /// A chunk of the view was refused, so the view has to be sent again.
    pub wants_view_again: bool,
    /// Frames made outside of the session machine.
    raw: Vec<Bytes>,
}

impl Client {
    pub fn new(number: u32, random: &mut Random) -> Self {
        Self {
            delivery: truth::deliveries()[number as usize % 4],
            window: [1, 4, 64][random.below(3)],
            backoff: Backoff::new(Duration::from_millis(100), Duration::from_secs(3), u64::from(number) + 1),
            held: BTreeSet::new(),
            view: None,
            next_view: FIRST_VIEW,
            next_invalid: FIRST_INVALID,
            requests: 0,
            session: None,
            is_settled: false,
            wants_view_again: false,
            raw: Vec::new(),
        }
    }

    /// The connection is open.
    pub fn connect(&mut self, plant: Plant) {
        let mut session = ClientSession::new(ClientConfig {
            digest: Some(truth::digest()),
            delivery: self.delivery,
            token: None,
            software: "simulation".into(),
            window: self.window,
        });
        let mut held: Vec<ChunkKey> = self.held.iter().copied().collect();
        if plant == Plant::FalseHolding {
            held.extend(self.view.iter().flat_map(truth::needed).step_by(3));
        }
        session.holding(&held);
        if let Some(view) = self.view {
            session.set_view(view);
        }
        self.requests = 0;
        self.session = Some((session, Ledger::default()));
        self.is_settled = false;
    }

    /// The connection is lost. Returns the delay before the next.
    pub fn lose(&mut self) -> u64 {
        self.session = None;
        self.raw.clear();
        self.backoff.next_delay().as_millis() as u64
    }

    /// Sends a view from a random pose.
    pub fn look(&mut self, random: &mut Random) {
        let mut metres = || (random.within(-RANGE_M..RANGE_M) * 256) as i32;
        let eye = [metres(), 60 * 256, metres()];
        let yaw_mdeg = random.within(0..360_000) as i32;
        let view = test_support::view(self.next_view, random.within(100..400) as u32);
        self.send_view(View { eye, yaw_mdeg, tolerance_q4: 128, ..view });
    }

    /// Sends the present view again, with a new id.
    pub fn look_again(&mut self) {
        self.wants_view_again = false;
        if let Some(view) = self.view {
            self.send_view(View { id: self.next_view, ..view });
        }
    }

    fn send_view(&mut self, view: View) {
        self.next_view += 1;
        self.view = Some(view);
        self.is_settled = false;
        if let Some((session, _)) = &mut self.session {
            session.set_view(view);
        }
    }

    /// Requests some chunks of the present view, which it needs whatever becomes of the request.
    pub fn request_needed(&mut self, random: &mut Random) {
        let (Some(view), Some((session, _))) = (&self.view, &mut self.session) else { return };
        let is_chosen = |key: &ChunkKey| !self.held.contains(key) && random.percent(40);
        let keys: Vec<ChunkKey> = truth::needed(view).into_iter().filter(is_chosen).take(MAX_KEYS).collect();
        if !keys.is_empty() {
            session.request(&keys);
            self.requests += 1;
        }
    }

    /// Cancels the last request.
    pub fn cancel_last(&mut self) {
        if let Some(id) = self.requests.checked_sub(1) {
            self.send_raw(&ClientMessage::Cancel { id });
        }
    }

    /// Does something random and valid.
    pub fn act(&mut self, random: &mut Random) {
        let choice = random.below(10);
        let Some((session, _)) = &mut self.session else { return };
        match choice {
            0..4 => self.look(random),
            4..6 => {
                let keys: Vec<ChunkKey> = (0..random.within(1..6)).map(|_| random_key(random)).collect();
                session.request(&keys);
                self.requests += 1;
            }
            6 => {
                let keys: Vec<ChunkKey> = self.held.iter().copied().filter(|_| random.percent(20)).collect();
                for key in &keys {
                    self.held.remove(key);
                }
                session.release(&keys);
            }
            7 if self.requests > 0 => {
                let id = random.below(self.requests as usize) as u32;
                self.send_raw(&ClientMessage::Cancel { id });
            }
            8 => {
                for _ in 0..4 {
                    let keys = (0..INVALID_KEYS).map(|z| WireKey { level: 0, x: i32::MAX, z }).collect();
                    self.next_invalid += 1;
                    self.send_raw(&ClientMessage::Request { id: self.next_invalid, keys });
                }
            }
            _ => {}
        }
    }

    fn send_raw(&mut self, message: &ClientMessage) {
        self.raw.push(control::encode(message).expect("a valid message"));
    }

    /// The next frame to send. The ledger counts it.
    pub fn poll_transmit(&mut self) -> Option<Bytes> {
        let (session, ledger) = self.session.as_mut()?;
        // The Hello is the first frame; a request comes before its cancellation.
        let frame = session.poll_transmit().or_else(|| (!self.raw.is_empty()).then(|| self.raw.remove(0)))?;
        ledger.sent(&control::decode(&frame).expect("a client's own frame"));
        Some(frame)
    }

    /// A frame arrives; an error is a violated invariant.
    pub fn receive(&mut self, frame: &[u8]) -> Result<(), String> {
        let Some((session, ledger)) = &mut self.session else { return Ok(()) };
        match session.receive(DataFrame::Binary(frame)).map_err(|fault| fault.to_string())? {
            Event::Chunk { chunk, delivery, .. } => {
                if !truth::is_right(&chunk, delivery) {
                    return Err(format!("chunk {} is not the generated one", chunk.key));
                }
                ledger.arrived(chunk.key)?;
                self.held.insert(chunk.key);
            }
            Event::Settled(settled) => {
                self.is_settled |= self.view.is_some_and(|view| view.id == settled.view);
            }
            Event::Refused(refused) => {
                ledger.refused(&refused)?;
                self.wants_view_again |= refused.id >= FIRST_VIEW && refused.id < FIRST_INVALID;
            }
            Event::Welcome(_) => self.backoff.reset(),
            Event::Draining { .. } => {}
        }
        Ok(())
    }

    /// At rest after the faults: the view is complete and every request answered.
    pub fn check_complete(&self) -> Result<(), String> {
        let Some((_, ledger)) = &self.session else { return Err("not connected".into()) };
        let view = self.view.as_ref().ok_or("no view")?;
        if !self.is_settled {
            return Err(format!("view {} is not settled", view.id));
        }
        if let Some(key) = truth::needed(view).iter().find(|key| !self.held.contains(key)) {
            return Err(format!("view {} is settled without chunk {key}", view.id));
        }
        ledger.check_answers()
    }
}

/// A chunk near the clients, of any of the finer levels.
fn random_key(random: &mut Random) -> ChunkKey {
    let level = random.below(3) as u8;
    let mut coordinate = || random.within(-3..3) as i32;
    ChunkKey::new(level, coordinate(), coordinate()).expect("inside the world")
}
