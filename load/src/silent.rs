//! A silent client (`--silent`): it opens the WebSocket and sends no Hello, or sends one view and
//! then nothing more.
//!
//! It reads all bytes but answers no ping, so only its inactivity can be the reason for a close,
//! which it reads from the close frame.

use crate::SOFTWARE;
use crate::dial::Dial;
use crate::path::FlightPath;
use crate::session::{connect, transmit, view_of};
use crate::task::{SessionEnd, Task};
use protocol::CloseCode;
use protocol::client::{ClientConfig, ClientSession};
use terrain::{Land, Start};
use tokio::io::{AsyncRead, AsyncReadExt};

/// Credit of a client with a view: enough that the server has chunks to send.
const WINDOW: u32 = 64;

/// Where its path begins: it sends one view only, and the Welcome that names the world is not read.
const ANYWHERE: Start = Start { x: 0, z: 0, inland: (i16::MAX as i32, 0) };

/// Bytes read at once.
const BUFFER: usize = 4096;

/// Runs a silent client until the server closes the connection or the run ends.
pub async fn run<D: Dial>(task: &Task<'_, D>) {
    match task.until(task.end, stay_silent(task)).await {
        Some(Ok(why)) => task.counters.closed(&why),
        Some(Err(SessionEnd::NotAdmitted { problem, .. } | SessionEnd::Unreachable(problem))) => {
            task.counters.refused(&problem);
        }
        Some(Err(
            SessionEnd::Lost(problem) | SessionEnd::Wrong(problem) | SessionEnd::OtherWorld(problem),
        )) => {
            task.counters.closed(&problem);
        }
        Some(Err(SessionEnd::Finished)) | None => task.counters.stayed(),
    }
}

/// Connects and waits for the close. Returns its reason.
async fn stay_silent<D: Dial>(task: &Task<'_, D>) -> Result<String, SessionEnd> {
    let mut socket = connect(task).await?;
    task.admitted();
    if task.index % 2 == 1 {
        let mut session = ClientSession::new(ClientConfig {
            digest: None,
            delivery: task.config.delivery,
            token: task.config.token.clone(),
            software: SOFTWARE.into(),
            window: WINDOW,
        });
        let path = FlightPath::new(task.config.path, task.config.seed, task.index, ANYWHERE);
        // Any land serves: the height of the pose does not matter.
        session.set_view(view_of(0, &path.pose(&Land::new(0), 0.0), task.config.view_distance_m));
        transmit(&mut socket, &mut session).await.map_err(SessionEnd::Lost)?;
    }
    Ok(close_reason(socket.into_inner()).await)
}

/// Reads to the end. Returns the reason in the close frame.
async fn close_reason(mut stream: impl AsyncRead + Unpin) -> String {
    let mut scan = CloseScanner::default();
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

/// Scans WebSocket frames (RFC 6455, section 5.2) for a close frame without storing them.
#[derive(Debug, Default)]
struct CloseScanner {
    /// The head of a frame: opcode, length, and the code of a close frame. At most 12 bytes.
    head: Vec<u8>,
    /// Bytes of the current frame to skip.
    skip: u64,
}

impl CloseScanner {
    /// Scans bytes. Returns the code of a close frame, 1005 if it has none.
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

    /// Offset and length of the payload, once known. Frames of a server are not masked.
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
    fn a_close_frame_is_found_in_any_split_of_the_bytes() {
        let bytes = stream();
        for size in 1..bytes.len() {
            let mut scan = CloseScanner::default();
            let found: Vec<u16> = bytes.chunks(size).filter_map(|part| scan.close(part)).take(1).collect();
            assert_eq!(found, [CloseCode::HandshakeTimeout.code()], "in parts of {size}");
        }
        assert_eq!(
            CloseScanner::default().close(&stream()[..309]),
            None,
            "control: bytes like a close frame inside a payload"
        );
        assert_eq!(CloseScanner::default().close(&[0x88, 0]), Some(1005));
    }
}
