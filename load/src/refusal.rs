//! A refusal over HTTP as one line for people, of a request or of the upgrade to WebSocket.

use hyper::StatusCode;
use protocol::peer_text::one_line;
use serde::Deserialize;

/// The field of a problem document (RFC 9457) that describes the occasion.
#[derive(Deserialize)]
struct Problem {
    detail: String,
}

/// Status and message of the body. A Tombolo server sends a problem document with one sentence; a
/// proxy sends anything.
pub(crate) fn refusal(status: StatusCode, body: &[u8]) -> String {
    let detail = serde_json::from_slice::<Problem>(body).map(|problem| problem.detail);
    let text = detail.unwrap_or_else(|_| String::from_utf8_lossy(body).into_owned());
    let line = one_line(text.lines().next().unwrap_or_default());
    if line.is_empty() { status.to_string() } else { format!("{status}: {line}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_are_one_line_from_any_server() {
        let status = "503 Service Unavailable";
        for (body, line) in [
            (r#"{"status": 503, "detail": "come back"}"#, format!("{status}: come back")),
            (r#"{"status": 503, "detail": "\u001b[2Jcome\nback"}"#, format!("{status}: ?[2Jcome")),
            ("<html>\nproxy", format!("{status}: <html>")),
            ("\x1b]0;title\x07", format!("{status}: ?]0;title?")),
            ("", status.into()),
        ] {
            assert_eq!(refusal(StatusCode::SERVICE_UNAVAILABLE, body.as_bytes()), line);
        }
    }
}
