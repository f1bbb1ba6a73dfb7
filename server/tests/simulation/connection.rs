//! The client's end of a connection: frames of RFC 6455 around the messages of its machine.

use crate::client::Client;
use crate::link::ClientEnd;
use crate::plant::Plant;
use crate::received::Received;
use protocol::CloseCode;
use std::time::Duration;
use test_support::Random;
use tokio::io::{self, AsyncReadExt, AsyncWriteExt, DuplexStream, ReadHalf, WriteHalf};
use tokio::sync::mpsc;
use tokio::task::spawn_local;
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

const BINARY: u8 = 2;
const CLOSE: u8 = 8;
const PING: u8 = 9;
const PONG: u8 = 10;

/// Time from a refused chunk of a view to the same view again.
const RECHECK_DELAY: Duration = Duration::from_millis(150);

/// A received frame: opcode and payload.
type Frame = (u8, Vec<u8>);

/// What the client does and when.
pub struct Actions {
    pub random: Random,
    pub plant: Plant,
    /// Random actions end then, and the last ones follow.
    pub end: Instant,
    pub last: Last,
    pub received: Received,
}

/// The next of the last actions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Last {
    /// A view, and a request of some of its chunks.
    View,
    /// The end of that request.
    Cancel,
    Nothing,
}

impl Actions {
    /// The time of the next action, none after the last.
    fn next(&mut self) -> Option<Instant> {
        let now = Instant::now();
        let soon = now + Duration::from_millis(self.random.ms(20..600));
        match self.last {
            Last::View => Some(soon.min(self.end.max(now))),
            Last::Cancel => Some(now + Duration::from_millis(self.random.ms(1..300))),
            Last::Nothing => None,
        }
    }

    fn act(&mut self, client: &mut Client) {
        match self.last {
            Last::View if Instant::now() < self.end => client.act(&mut self.random),
            Last::View => {
                client.look(&mut self.random);
                client.request_needed(&mut self.random);
                self.last = Last::Cancel;
            }
            Last::Cancel => {
                client.cancel_last();
                self.last = Last::Nothing;
            }
            Last::Nothing => {}
        }
    }
}

/// Drives a client's machine until the connection is lost.
///
/// # Errors
/// A violated invariant.
pub async fn drive(end: ClientEnd, client: &mut Client, actions: &mut Actions) -> Result<(), String> {
    let (read, mut write) = io::split(end.stream);
    // One frame: while the machine does not take it, the reader stops.
    let (sender, mut frames) = mpsc::channel(1);
    let _reader = AbortOnDropHandle::new(spawn_local(read_frames(read, sender)));
    let (mut act_at, mut recheck_at) = (actions.next(), None);
    let mut messages = 0;
    loop {
        while let Some(message) = client.poll_transmit() {
            messages += 1;
            // The first is the Hello.
            if actions.plant == Plant::LostMessage && messages > 1 && actions.random.percent(5) {
                continue;
            }
            if !sent(&mut write, &end.lost, BINARY, &message).await {
                return Ok(());
            }
        }
        tokio::select! {
            biased;
            () = end.lost.cancelled() => return Ok(()),
            frame = frames.recv() => match frame {
                None => return Ok(()),
                Some((BINARY, message)) => {
                    let is_twice = actions.plant == Plant::FrameTwice && actions.random.percent(2);
                    for _ in 0..=u32::from(is_twice) {
                        client.receive(&message)?;
                        actions.received.message(&message);
                    }
                    if std::mem::take(&mut client.wants_view_again) {
                        recheck_at = Some(Instant::now() + RECHECK_DELAY);
                    }
                }
                Some((PING, payload)) => {
                    if !sent(&mut write, &end.lost, PONG, &payload).await {
                        return Ok(());
                    }
                }
                Some((CLOSE, payload)) => return closed(&payload),
                Some((opcode, _)) => return Err(format!("a frame of opcode {opcode}")),
            },
            () = sleep_until_some(act_at), if act_at.is_some() => {
                actions.act(client);
                act_at = actions.next();
            }
            () = sleep_until_some(recheck_at), if recheck_at.is_some() => {
                recheck_at = None;
                client.look_again();
            }
        }
    }
}

async fn sleep_until_some(moment: Option<Instant>) {
    match moment {
        Some(moment) => sleep_until(moment).await,
        None => std::future::pending().await,
    }
}

/// Whether a close code is of a fault of the network or of the server's end. Any other would blame
/// the client, which breaks no rule.
fn closed(payload: &[u8]) -> Result<(), String> {
    let code = payload.first_chunk().map(|code| u16::from_be_bytes(*code)).and_then(CloseCode::from_code);
    let reason = || String::from_utf8_lossy(payload.get(2..).unwrap_or_default()).into_owned();
    match code {
        Some(CloseCode::GoingAway | CloseCode::Unresponsive | CloseCode::HandshakeTimeout) => Ok(()),
        _ => Err(format!("closed with {code:?}: {}", reason())),
    }
}

/// Writes one frame, masked by zeros. False if the connection is lost.
async fn sent(
    write: &mut WriteHalf<DuplexStream>,
    lost: &CancellationToken,
    opcode: u8,
    payload: &[u8],
) -> bool {
    let length = match (u8::try_from(payload.len()), u16::try_from(payload.len())) {
        (Ok(short @ 0..126), _) => vec![0x80 | short],
        (_, Ok(medium)) => [&[0x80 | 126][..], &medium.to_be_bytes()].concat(),
        _ => [&[0x80 | 127][..], &(payload.len() as u64).to_be_bytes()].concat(),
    };
    let frame = [&[0x80 | opcode], &length[..], &[0; 4], payload].concat();
    tokio::select! {
        biased;
        written = write.write_all(&frame) => written.is_ok(),
        () = lost.cancelled() => false,
    }
}

/// Reads frames until the connection is lost.
async fn read_frames(mut read: ReadHalf<DuplexStream>, frames: mpsc::Sender<Frame>) {
    while let Ok(frame) = read_frame(&mut read).await {
        if frames.send(frame).await.is_err() {
            break;
        }
    }
}

/// One frame. Frames of the server are whole messages.
async fn read_frame(read: &mut ReadHalf<DuplexStream>) -> io::Result<Frame> {
    let opcode = read.read_u8().await? & 15;
    let length = match read.read_u8().await? {
        126 => u64::from(read.read_u16().await?),
        127 => read.read_u64().await?,
        short => u64::from(short),
    };
    let mut payload = Vec::new();
    let count = read.take(length).read_to_end(&mut payload).await?;
    if (count as u64) < length {
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    Ok((opcode, payload))
}
