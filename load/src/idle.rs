//! A client that is silent: it opens the WebSocket and never says Hello, or asks for a view and
//! then neither speaks nor answers.
//!
//! The bytes that come are taken, so that silence is all that there is against it, but no ping is
//! answered. How the server ends it is read from its close frame.

use crate::SOFTWARE;
use crate::client::{End, Task};
use crate::dial::Dial;
use crate::path::FlightPath;
use crate::session::{connect, transmit, view_of};
use protocol::CloseCode;
use protocol::client::{ClientConfig, ClientSession};
use terrain::Land;
use tokio::io::{AsyncRead, AsyncReadExt};
use tokio::time::timeout_at;

/// Chunks that one lets the server send: enough for it to have something to say.
const WINDOW: u32 = 64;

/// Bytes read at once.
const BUFFER: usize = 4096;

/// Runs one until the server or the run ends it.
pub async fn run<D: Dial>(task: &Task<'_, D>) {
    match timeout_at(task.end, keep_silent(task)).await {
        Ok(Ok(why)) => task.counters.closed(&why),
        Ok(Err(End::NotAdmitted { problem, .. })) => task.counters.refused(&problem),
        Ok(Err(End::Lost(problem) | End::Wrong(problem))) => task.counters.closed(&problem),
        Ok(Err(End::Finished)) | Err(_) => task.counters.stayed(),
    }
}

/// Connects and waits for the end. Returns how the server explains it.
async fn keep_silent<D: Dial>(task: &Task<'_, D>) -> Result<String, End> {
    let mut socket = connect(task).await?;
    task.counters.admitted();
    if task.index % 2 == 1 {
        let mut session = ClientSession::new(ClientConfig {
            digest: None,
            delivery: task.config.delivery,
            token: task.config.token.clone(),
            software: SOFTWARE.into(),
            window: WINDOW,
        });
        let path = FlightPath::new(task.config.path, task.config.seed, task.index);
        // Any land does: the height of one pose matters to nobody.
        session.set_view(view_of(0, &path.pose(&Land::new(0), 0.0), task.config.view_distance_m));
        transmit(&mut socket, &mut session).await.map_err(End::Lost)?;
    }
    Ok(last_words(socket.into_inner()).await)
}

/// Reads to the end. Returns what the close frame said.
async fn last_words(mut stream: impl AsyncRead + Unpin) -> String {
    let mut scan = Scan::default();
    let mut buffer = [0; BUFFER];
    loop {
        match stream.read(&mut buffer).await {
            Ok(0) => return "the connection ended without a close frame".into(),
            Ok(n) => {
                if let Some(code) = scan.close(&buffer[..n]) {
                    let known = CloseCode::from_code(code).map(|code| code.to_string());
                    return known.unwrap_or_else(|| format!("code {code}"));
                }
            }
            Err(error) => return format!("the connection broke: {error}"),
        }
    }
}

/// Walks over WebSocket frames (RFC 6455, section 5.2) without keeping them, looking for a close.
#[derive(Debug, Default)]
struct Scan {
    /// The beginning of a frame: opcode, length, and of a close the two bytes of its code. At most
    /// 12 bytes.
    head: Vec<u8>,
    /// Bytes of the present frame still to be passed over.
    skip: u64,
}

impl Scan {
    /// Takes bytes; the code of a close frame among them, 1005 if it has none.
    fn close(&mut self, mut bytes: &[u8]) -> Option<u16> {
        while let Some((first, rest)) = bytes.split_first() {
            if self.skip > 0 {
                let passed = (bytes.len() as u64).min(self.skip);
                self.skip -= passed;
                bytes = &bytes[passed as usize..];
                continue;
            }
            self.head.push(*first);
            bytes = rest;
            let Some((start, length)) = self.frame() else { continue };
            if self.head[0] & 15 != 8 {
                self.skip = length;
                self.head.clear();
            } else if length < 2 {
                return Some(1005);
            } else if let Some([high, low]) = self.head.get(start..start + 2) {
                return Some(u16::from_be_bytes([*high, *low]));
            }
        }
        None
    }

    /// Where the payload begins and its length, once that is known. A server's frames are not
    /// masked.
    fn frame(&self) -> Option<(usize, u64)> {
        let [_, second, rest @ ..] = self.head.as_slice() else { return None };
        match second & 127 {
            126 => rest.first_chunk().map(|length| (4, u64::from(u16::from_be_bytes(*length)))),
            127 => rest.first_chunk().map(|length| (10, u64::from_be_bytes(*length))),
            short => Some((2, u64::from(short))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stream() -> Vec<u8> {
        let mut bytes = vec![0x82, 3, 1, 2, 3, 0x82, 126, 1, 44];
        bytes.extend([0x88; 300]);
        bytes.extend([0x89, 0, 0x82, 127, 0, 0, 0, 0, 0, 0, 0, 2, 8, 8]);
        bytes.extend([0x88, 5, 17, 56, b'b', b'y', b'e']);
        bytes
    }

    #[test]
    fn a_close_is_found_behind_any_frames_however_the_bytes_are_cut() {
        let bytes = stream();
        for size in 1..bytes.len() {
            let mut scan = Scan::default();
            let found: Vec<u16> = bytes.chunks(size).filter_map(|part| scan.close(part)).take(1).collect();
            assert_eq!(found, [CloseCode::HandshakeTimeout.code()], "in parts of {size}");
        }
        assert_eq!(
            Scan::default().close(&stream()[..309]),
            None,
            "the control: bytes like a close inside of a frame"
        );
        assert_eq!(Scan::default().close(&[0x88, 0]), Some(1005));
    }
}
