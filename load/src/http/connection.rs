//! One persistent HTTP/1.1 connection with bounded responses.

use crate::SOFTWARE;
use crate::dial::Dial;
use crate::refusal::refusal;
use crate::task::Task;
use crate::throttle::Throttled;
use bytes::Bytes;
use http_body_util::{BodyExt, Empty, Limited};
use hyper::client::conn::http1::{self, SendRequest};
use hyper::header::{AUTHORIZATION, ETAG, HOST, HeaderMap, IF_NONE_MATCH, RETRY_AFTER, USER_AGENT};
use hyper::{Request, StatusCode};
use hyper_util::rt::TokioIo;
use std::fmt::Write;
use std::time::Duration;
use tokio::task::JoinHandle;

/// Maximal length of a body, bytes. Chunk frames, the world's description and errors are shorter.
const MAX_BODY: usize = 64 * 1024;

/// Pause after a refusal without Retry-After.
const DEFAULT_PAUSE: Duration = Duration::from_secs(1);

/// A complete response.
#[derive(Debug)]
pub(super) struct Response {
    pub status: StatusCode,
    /// The strong ETag, if it is a digest.
    pub tag: Option<[u8; 16]>,
    pub retry_after: Duration,
    pub body: Bytes,
}

impl Response {
    /// Status and message of the body, in one line.
    pub fn problem(&self) -> String {
        refusal(self.status, &self.body)
    }
}

/// See the module.
#[derive(Debug)]
pub(super) struct Connection {
    sender: SendRequest<Empty<Bytes>>,
    /// Transports the bytes; ends with the connection.
    driver: JoinHandle<()>,
    host: String,
    authorization: Option<String>,
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.driver.abort();
    }
}

impl Connection {
    pub async fn open<D: Dial>(task: &Task<'_, D>) -> Result<Self, String> {
        let stream = task.dial.dial(None).await.map_err(|error| error.to_string())?;
        let io = TokioIo::new(Throttled::new(stream, task.read_rate));
        let (sender, connection) = http1::handshake(io).await.map_err(|error| error.to_string())?;
        // The pending request gets the error.
        let driver = tokio::spawn(async move { _ = connection.await });
        let config = task.config;
        let host = config.connect.authority().map_or_else(String::new, ToString::to_string);
        let authorization = config.token.as_ref().map(|token| format!("Bearer {token}"));
        Ok(Self { sender, driver, host, authorization })
    }

    /// Whether the connection is still open.
    pub async fn is_usable(&mut self) -> bool {
        self.sender.ready().await.is_ok()
    }

    /// Sends a GET, conditional if an ETag is known.
    pub async fn get(&mut self, path: &str, known: Option<[u8; 16]>) -> Result<Response, String> {
        let mut request = Request::get(path).header(HOST, &self.host).header(USER_AGENT, SOFTWARE);
        if let Some(authorization) = &self.authorization {
            request = request.header(AUTHORIZATION, authorization);
        }
        if let Some(tag) = known {
            request = request.header(IF_NONE_MATCH, tag_text(tag));
        }
        let request = request.body(Empty::new()).map_err(|error| error.to_string())?;
        let answer = self.sender.send_request(request).await.map_err(|error| explain(&error))?;
        let (status, headers) = (answer.status(), answer.headers());
        let (tag, retry_after) = (tag_of(headers), retry_after(headers));
        let body =
            Limited::new(answer.into_body(), MAX_BODY).collect().await.map_err(|error| explain(&*error))?;
        Ok(Response { status, tag, retry_after, body: body.to_bytes() })
    }
}

/// An error with its causes, as one line.
fn explain(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    let causes: Vec<_> = causes.map(ToString::to_string).collect();
    format!("the connection broke: {}", causes.join(": "))
}

fn tag_text(tag: [u8; 16]) -> String {
    let mut text = String::from("\"");
    // Writing to a string cannot fail.
    tag.iter().for_each(|byte| _ = write!(text, "{byte:02x}"));
    text + "\""
}

fn tag_of(headers: &HeaderMap) -> Option<[u8; 16]> {
    let text = headers.get(ETAG)?.to_str().ok()?.strip_prefix('"')?.strip_suffix('"')?;
    let mut tag = [0; 16];
    if text.len() != 2 * tag.len() || !text.is_ascii() {
        return None;
    }
    for (index, byte) in tag.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&text[2 * index..2 * index + 2], 16).ok()?;
    }
    Some(tag)
}

fn retry_after(headers: &HeaderMap) -> Duration {
    let seconds = headers.get(RETRY_AFTER).and_then(|value| value.to_str().ok()?.parse().ok());
    seconds.map_or(DEFAULT_PAUSE, Duration::from_secs)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(tag: &str) -> HeaderMap {
        HeaderMap::from_iter([(ETAG, tag.parse().unwrap())])
    }

    #[test]
    fn only_quoted_digests_are_etags() {
        let tag = std::array::from_fn(|index| index as u8 * 17);
        assert_eq!(tag_of(&headers(&tag_text(tag))), Some(tag));
        for bad in [
            "",
            "\"\"",
            "\"00\"",
            "W/\"00112233445566778899aabbccddeeff\"",
            "00112233445566778899aabbccddeeff",
            "\"0011223344556677889 aabbccddeeff\"",
            "\"zz112233445566778899aabbccddeeff\"",
        ] {
            assert_eq!(tag_of(&headers(bad)), None, "{bad}");
        }
    }
}
