//! Clients behind proxies: by headers and by the PROXY protocol.

use crate::client::{Server, UPGRADE, request_over};
use server::ServerConfig;
use server::access::tokens::TokenSet;
use server::proxy::{ProxyHeader, TrustedProxies};
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;

/// One session per client, behind a proxy at 127.0.0.1.
fn behind(header: ProxyHeader) -> ServerConfig {
    ServerConfig {
        threads: 1,
        max_sessions_per_address: Some(1),
        proxies: TrustedProxies::parse(&["127.0.0.1".to_owned()], Some(header)).unwrap(),
        ..ServerConfig::default()
    }
}

/// Opens a session and keeps it.
async fn open(server: &Server, source: [u8; 4], headers: &[(&str, &str)]) -> (u16, TcpStream) {
    server.open_session_with(source, &[], headers).await
}

#[tokio::test]
async fn limits_count_the_clients_of_a_named_proxy() {
    for (header, name, prefix) in
        [(ProxyHeader::XForwardedFor, "X-Forwarded-For", ""), (ProxyHeader::Forwarded, "Forwarded", "for=")]
    {
        let server = Server::start_with(behind(header)).await;
        let claimed = |address: &str| format!("{prefix}198.51.100.9, {prefix}{address}");
        let (one, other) = (claimed("192.0.2.1"), claimed("192.0.2.2"));
        let (status, _first) = open(&server, [127, 0, 0, 1], &[(name, &one)]).await;
        assert_eq!(status, 101);
        assert_eq!(open(&server, [127, 0, 0, 1], &[(name, &one)]).await.0, 503, "the same client");
        // What a client claims of itself changes nothing, be it text or not.
        for lie in ["203.0.113.7", "\u{ff}"] {
            let lie = format!("{prefix}{lie}, {one}");
            assert_eq!(open(&server, [127, 0, 0, 1], &[(name, &lie)]).await.0, 503);
        }
        let (status, _second) = open(&server, [127, 0, 0, 1], &[(name, &other)]).await;
        assert_eq!(status, 101, "another client");
    }
}

#[cfg(target_os = "linux")]
#[tokio::test]
async fn a_header_of_an_unnamed_peer_is_ignored() {
    let server = Server::start_with(behind(ProxyHeader::XForwardedFor)).await;
    let stranger = [127, 0, 0, 2];
    let (status, _first) = open(&server, stranger, &[("X-Forwarded-For", "192.0.2.1")]).await;
    assert_eq!(status, 101);
    for spoofed in ["192.0.2.2", "192.0.2.3"] {
        assert_eq!(open(&server, stranger, &[("X-Forwarded-For", spoofed)]).await.0, 503);
    }
    // The named proxy's client of that address is another one.
    let (status, _second) = open(&server, [127, 0, 0, 1], &[("X-Forwarded-For", "192.0.2.1")]).await;
    assert_eq!(status, 101);
}

#[tokio::test]
async fn guesses_of_one_client_do_not_throttle_the_others_behind_a_proxy() {
    let config = ServerConfig { tokens: Some(TokenSet::one("sesame")), ..behind(ProxyHeader::XForwardedFor) };
    let server = Server::start_with(config).await;
    let get = async |client: &str, token: &str| {
        let headers = [("X-Forwarded-For", client), ("Authorization", token)];
        server.request("GET", "/v1/live", &headers).await.status
    };
    for guess in 0..30 {
        get("192.0.2.1", &format!("Bearer {guess}")).await;
    }
    assert_eq!(get("192.0.2.1", "Bearer sesame").await, 429);
    assert_eq!(get("192.0.2.2", "Bearer sesame").await, 200);
}

#[cfg(target_os = "linux")]
#[tokio::test]
async fn the_proxy_protocol_is_required_of_named_proxies_and_refused_from_others() {
    let config = ServerConfig {
        handshake_timeout: std::time::Duration::from_millis(500),
        ..behind(ProxyHeader::ProxyProtocol)
    };
    let server = Server::start_with(config).await;
    let header = |address: &str| format!("PROXY TCP4 {address} 127.0.0.1 4711 80\r\n");
    let proxy = [127, 0, 0, 1];
    let (status, _first) = server.open_session_with(proxy, header("192.0.2.1").as_bytes(), &[]).await;
    assert_eq!(status, 101);
    let (status, _) = server.open_session_with(proxy, header("192.0.2.1").as_bytes(), &[]).await;
    assert_eq!(status, 503, "the same client");
    let (status, _second) = server.open_session_with(proxy, header("192.0.2.2").as_bytes(), &[]).await;
    assert_eq!(status, 101, "another client");
    // Version 2, of a probe by the proxy itself.
    let mut probe = TcpStream::connect(server.address).await.unwrap();
    probe.write_all(b"\r\n\r\n\0\r\nQUIT\n\x20\0\0\0").await.unwrap();
    assert_eq!(request_over(probe, "GET", "/livez", &[]).await.status, 200);
    // A named proxy without the header is closed without an answer; so is a silent one.
    for bytes in [&b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n"[..], b"PROXY TCP4 1"] {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        stream.write_all(bytes).await.unwrap();
        assert_eq!(crate::client::read_all(stream).await, b"", "{bytes:?}");
    }
    // From a stranger the header is no HTTP.
    let (status, _) = server.open_session_with([127, 0, 0, 2], header("192.0.2.3").as_bytes(), &[]).await;
    assert_eq!(status, 400);
    let (status, _third) = server.open_session_with([127, 0, 0, 2], b"", &UPGRADE[..0]).await;
    assert_eq!(status, 101);
}
