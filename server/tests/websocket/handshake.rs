//! The opening handshake, byte by byte (RFC 6455, section 4.2; RFC 9112, section 3.2).

use crate::sessions::Server;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

/// A valid handshake, one header a line.
const VALID: [&str; 6] = [
    "Host: localhost",
    "Connection: keep-alive, Upgrade",
    "Upgrade: WebSocket",
    "Sec-WebSocket-Version: 13",
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
    "Sec-WebSocket-Protocol: tombolo.v1",
];

/// The head of the response to a handshake, in lower case.
async fn answer(server: &Server, version: &str, headers: &[&str]) -> String {
    let mut stream = server.connect().await;
    let request = format!("GET /v1/stream HTTP/{version}\r\n{}\r\n\r\n", headers.join("\r\n"));
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut bytes = Vec::new();
    while !bytes.windows(4).any(|four| four == b"\r\n\r\n") {
        assert!(stream.read_buf(&mut bytes).await.unwrap() > 0, "{}", String::from_utf8_lossy(&bytes));
    }
    String::from_utf8_lossy(&bytes).to_ascii_lowercase()
}

/// The valid headers, with those of a name replaced.
fn with<'a>(name: &str, values: &[&'a str]) -> Vec<&'a str> {
    let others = VALID.iter().copied().filter(|line| !line.starts_with(name));
    others.chain(values.iter().copied()).collect()
}

#[tokio::test]
async fn a_valid_handshake_is_accepted_with_the_digest_of_its_key() {
    let server = Server::start().await;
    let head = answer(&server, "1.1", &VALID).await;
    assert!(head.starts_with("http/1.1 101 "), "{head}");
    // The example of RFC 6455, section 1.3.
    assert!(head.contains("sec-websocket-accept: s3pplmbitxaq9kygzzhzrbk+xoo=\r\n"), "{head}");
    assert!(head.contains("sec-websocket-protocol: tombolo.v1\r\n"), "{head}");
    assert!(!head.contains("sec-websocket-extensions"), "{head}");
}

#[tokio::test]
async fn an_invalid_handshake_is_rejected_with_its_status() {
    let server = Server::start().await;
    let cases: [(&str, &str, &[&str], u16); 17] = [
        ("no key", "Sec-WebSocket-Key", &[], 400),
        ("an empty key", "Sec-WebSocket-Key", &["Sec-WebSocket-Key: "], 400),
        ("a key of 3 bytes", "Sec-WebSocket-Key", &["Sec-WebSocket-Key: AAAA"], 400),
        ("15 bytes", "Sec-WebSocket-Key", &["Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAA"], 400),
        ("17 bytes", "Sec-WebSocket-Key", &["Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAAA="], 400),
        ("no padding", "Sec-WebSocket-Key", &["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ"], 400),
        ("not base64", "Sec-WebSocket-Key", &["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25j!Q=="], 400),
        (
            "two keys",
            "Sec-WebSocket-Key",
            &["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="],
            400,
        ),
        ("no version", "Sec-WebSocket-Version", &[], 400),
        ("version 8", "Sec-WebSocket-Version", &["Sec-WebSocket-Version: 8"], 400),
        ("versions", "Sec-WebSocket-Version", &["Sec-WebSocket-Version: 13, 8"], 400),
        ("no Host", "Host", &[], 400),
        ("two Hosts", "Host", &["Host: localhost", "Host: test"], 400),
        ("no Upgrade", "Upgrade", &[], 426),
        ("another protocol", "Upgrade", &["Upgrade: h2c"], 426),
        ("no Connection", "Connection", &[], 426),
        ("Connection without Upgrade", "Connection", &["Connection: keep-alive"], 426),
    ];
    for (name, header, values, status) in cases {
        let head = answer(&server, "1.1", &with(header, values)).await;
        assert!(head.starts_with(&format!("http/1.1 {status} ")), "{name}: {head}");
        let names_version = head.contains("sec-websocket-version: 13\r\n");
        assert!(names_version || !header.ends_with("Version"), "{name}: {head}");
    }
    let old = answer(&server, "1.0", &VALID).await;
    assert!(old.starts_with("http/1.0 426 "), "{old}");
}
