//! The network between the two ends of a connection: bytes arrive late, in slices, and in order.

use crate::plant::Plant;
use std::cell::Cell;
use std::rc::Rc;
use std::time::Duration;
use test_support::Random;
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, ReadHalf, WriteHalf, duplex, split};
use tokio::task::spawn_local;
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

/// Bytes that the network holds at each end, in each direction.
const PIPE: usize = 64 * 1024;

/// Most bytes that arrive at once.
const SLICE: usize = 16 * 1024;

/// A connection. Dropping it cuts it.
pub struct Link {
    pub up: Rc<Direction>,
    pub down: Rc<Direction>,
    /// Cancelled when the client has lost the connection.
    lost: CancellationToken,
    _relays: [AbortOnDropHandle<()>; 2],
}

/// One direction of a connection.
pub struct Direction {
    latency: Duration,
    /// Nothing arrives before.
    pub stalled_until: Cell<Instant>,
    /// Until then bytes arrive one by one.
    pub sliced_until: Cell<Instant>,
    /// Nothing arrives any more, not even the end.
    is_silent: Cell<bool>,
}

/// The client's end of a connection.
pub struct ClientEnd {
    pub stream: DuplexStream,
    /// Cancelled when the client has lost the connection.
    pub lost: CancellationToken,
}

impl Link {
    /// A new connection, with the stream of the server.
    pub fn new(random: &mut Random, plant: Plant) -> (Self, ClientEnd, DuplexStream) {
        let ((client, near), (far, server)) = (duplex(PIPE), duplex(PIPE));
        let ((near_read, near_write), (far_read, far_write)) = (split(near), split(far));
        let mut direction = || {
            Rc::new(Direction {
                latency: Duration::from_millis(random.ms(1..60)),
                stalled_until: Cell::new(Instant::now()),
                sliced_until: Cell::new(Instant::now()),
                is_silent: Cell::new(false),
            })
        };
        let (up, down) = (direction(), direction());
        let loses = (plant == Plant::LostByte).then(|| random.clone());
        let relays = [
            relayed(near_read, far_write, Rc::clone(&up), None),
            relayed(far_read, near_write, Rc::clone(&down), loses),
        ]
        .map(|relay| AbortOnDropHandle::new(spawn_local(relay)));
        let lost = CancellationToken::new();
        let end = ClientEnd { stream: client, lost: lost.clone() };
        (Self { up, down, lost, _relays: relays }, end, server)
    }

    /// Ends the connection for the client; the server does not learn of it.
    pub fn fall_silent(&self) {
        for direction in [&self.up, &self.down] {
            direction.is_silent.set(true);
        }
        self.lost.cancel();
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.lost.cancel();
    }
}

/// Carries bytes until one end is gone; with random numbers it loses some.
async fn relayed(
    mut from: ReadHalf<DuplexStream>,
    mut to: WriteHalf<DuplexStream>,
    direction: Rc<Direction>,
    mut loses: Option<Random>,
) {
    let mut buffer = vec![0; SLICE];
    loop {
        let limit = if direction.sliced_until.get() > Instant::now() { 1 } else { SLICE };
        let count = from.read(&mut buffer[..limit]).await.unwrap_or(0);
        sleep_until(Instant::now() + direction.latency).await;
        while direction.stalled_until.get() > Instant::now() {
            sleep_until(direction.stalled_until.get()).await;
        }
        if direction.is_silent.get() {
            return std::future::pending().await;
        }
        if count == 0 {
            break;
        }
        let is_lost = loses.as_mut().is_some_and(|random| random.percent(2));
        if to.write_all(&buffer[..count - usize::from(is_lost)]).await.is_err() {
            break;
        }
    }
    // The other end may be gone.
    let _ = to.shutdown().await;
}
