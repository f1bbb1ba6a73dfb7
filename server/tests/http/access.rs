//! Host names, origins, tokens and shares of addresses.

use crate::client::{Server, welcomed};
use data_encoding::BASE64URL_NOPAD;
use server::ServerConfig;
use server::access::ProtectedRoute;
use server::access::hosts::{AllowedHosts, AllowedOrigins};
use server::access::tokens::{TokenFile, TokenSet};
use server::http::routes;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;

fn config() -> ServerConfig {
    ServerConfig { threads: 1, ..ServerConfig::default() }
}

fn with_token() -> ServerConfig {
    ServerConfig { tokens: Some(TokenSet::one("open sesame")), ..config() }
}

#[tokio::test]
async fn no_route_answers_a_request_for_an_unknown_host() {
    let allowed_hosts = AllowedHosts::parse(&["map.example".to_owned()]).unwrap();
    let server = Server::start_with(ServerConfig { allowed_hosts, ..config() }).await;
    let port = server.address.port();
    for route in routes().iter().map(|route| route.path) {
        let path = route.replace("{name}", "main.js").replace(['{', '}'], "");
        for host in ["evil.example", "127.0.0.1.evil.example:80", "evil"] {
            let reply = server.request("GET", &path, &[("Host", host)]).await;
            assert_eq!((reply.status, reply.problem().as_str()), (421, "unknown-host"), "{path} of {host}");
        }
        let absolute = format!("http://evil.example{path}");
        assert_eq!(server.request("GET", &absolute, &[]).await.status, 421, "{absolute}");
        for host in ["localhost", &format!("127.0.0.1:{port}"), "[::1]:80", "Map.Example:443"] {
            let status = server.request("GET", &path, &[("Host", host)]).await.status;
            assert_ne!(status, 421, "{path} of {host}");
        }
        assert_eq!(server.request("GET", &path, &[("Host", "a@b")]).await.status, 400);
    }
    let counted = "tombolo_requests_rejected_total{transport=\"http\",reason=\"unknown_host\"}";
    assert_eq!(server.metric(counted).await, 4.0 * routes().len() as f64);
}

#[tokio::test]
async fn a_page_of_another_origin_opens_no_session() {
    let allowed_origins = AllowedOrigins::parse(&["https://map.example".to_owned()]).unwrap();
    let server = Server::start_with(ServerConfig { allowed_origins, ..config() }).await;
    let own = format!("http://{}", server.address);
    let port = server.address.port();
    let host = format!("127.0.0.1:{port}");
    for origin in
        ["https://evil.example", "null", &format!("http://evil.example:{port}"), "http://map.example"]
    {
        let reply = server.upgrade(&[("Origin", origin), ("Host", &host)]).await;
        assert_eq!((reply.status, reply.problem().as_str()), (403, "foreign-origin"), "{origin}");
    }
    for origin in [own.as_str(), &format!("http://localhost:{port}"), "https://map.example"] {
        assert_eq!(server.upgrade(&[("Origin", origin), ("Host", &host)]).await.status, 101, "{origin}");
    }
    assert_eq!(server.upgrade(&[]).await.status, 101, "a program");
}

#[tokio::test]
async fn a_session_takes_its_token_from_a_header_a_subprotocol_entry_or_its_hello() {
    let server = Server::start_with(with_token()).await;
    let entry = |token: &str| format!("tombolo.bearer.{}", BASE64URL_NOPAD.encode(token.as_bytes()));
    let both = |token: &str| format!("{}, {}", entry(token), protocol::SUBPROTOCOL);
    for (name, value, hello, is_welcome) in [
        ("Authorization", "Bearer open sesame".to_owned(), None, true),
        ("Sec-WebSocket-Protocol", both("open sesame"), None, true),
        ("X-None", String::new(), Some("open sesame"), true),
        ("X-None", String::new(), None, false),
        ("X-None", String::new(), Some("wrong"), false),
    ] {
        let mut request = format!("ws://{}/v1/stream", server.address).into_client_request().unwrap();
        request.headers_mut().insert("Sec-WebSocket-Protocol", protocol::SUBPROTOCOL.parse().unwrap());
        request.headers_mut().insert(name, value.parse().unwrap());
        let stream = tokio::net::TcpStream::connect(server.address).await.unwrap();
        let (response, end) = welcomed(request, stream, hello).await;
        // Only the real subprotocol is echoed.
        assert_eq!(response.headers()["sec-websocket-protocol"], protocol::SUBPROTOCOL, "{name}");
        assert_eq!(end, if is_welcome { None } else { Some(4401) }, "{name} {hello:?}");
    }
    for header in [("Authorization", "Bearer wrong"), ("Sec-WebSocket-Protocol", &entry("wrong"))] {
        let reply = server.upgrade(&[header]).await;
        assert_eq!((reply.status, reply.problem().as_str()), (401, "unauthorised"), "{header:?}");
    }
    let reply = server.upgrade(&[("Sec-WebSocket-Protocol", "tombolo.bearer.%%")]).await;
    assert_eq!((reply.status, reply.problem().as_str()), (400, "bad-handshake"));
    assert!(!String::from_utf8(reply.body).unwrap().contains("%%"), "a token is repeated nowhere");
}

#[tokio::test]
async fn an_address_that_guesses_tokens_is_throttled_and_others_are_not() {
    let server = Server::start_with(with_token()).await;
    let path = server.path("height/0/0");
    let right = [("Authorization", "Bearer open sesame")];
    let mut statuses = Vec::new();
    for guess in 0..40 {
        let token = format!("Bearer {guess}");
        let wrong = [("Authorization", token.as_str())];
        // Routes and sessions have one budget.
        let reply = match guess % 2 {
            0 => server.request("GET", &path, &wrong).await,
            _ => server.upgrade(&wrong).await,
        };
        statuses.push(reply.status);
        if reply.status == 429 {
            assert_eq!((reply.header("retry-after"), reply.problem().as_str()), ("60", "too-many-guesses"));
        }
    }
    assert_eq!(statuses[..10], [401; 10]);
    // One more is allowed every six seconds.
    let refused = statuses[10..].iter().filter(|status| **status == 429).count();
    assert!(refused > 20, "{statuses:?}");
    assert_eq!(server.request("GET", &path, &right).await.status, 429, "the right one is not looked at");
    assert_eq!(server.request_from([127, 0, 0, 2], &path, &right).await.status, 200);
    assert_eq!(server.get("/v1/world").await.status, 200);
    assert!(server.metric("tombolo_tokens_refused_total{outcome=\"throttled\"}").await >= 21.0);
    assert!(server.metric("tombolo_tokens_refused_total{outcome=\"wrong\"}").await >= 10.0);
}

/// A page of another origin presents tokens from the address of its visitor.
#[tokio::test]
async fn guesses_of_a_page_of_another_origin_do_not_throttle_its_visitor() {
    let server = Server::start_with(with_token()).await;
    let path = server.path("height/0/0");
    let page = ("Origin", "https://elsewhere.example");
    let mut last = 0;
    for guess in 0..40 {
        let token = format!("Bearer {guess}");
        last = server.request("GET", &path, &[("Authorization", token.as_str()), page]).await.status;
    }
    assert_eq!(last, 429);
    let right = ("Authorization", "Bearer open sesame");
    assert_eq!(server.request("GET", &path, &[right, page]).await.status, 429, "its own guesses count");
    assert_eq!(server.request("GET", &path, &[right]).await.status, 200);
    assert_eq!(server.request("GET", &path, &[right, ("Origin", "http://localhost")]).await.status, 200);
}

/// A server with an expired token, `one`, and a valid one, `two`, from a file of this name.
async fn with_token_list(name: &str) -> Server {
    let path = std::env::temp_dir().join(format!("tombolo-{name}-{}.toml", std::process::id()));
    let list = "[[token]]\nname = \"old\"\ntoken = \"one\"\nexpires = 2020-01-01T00:00:00Z\n\
        [[token]]\nname = \"new\"\ntoken = \"two\"\nexpires = 2999-01-01T00:00:00Z\n";
    std::fs::write(&path, list).unwrap();
    let tokens = TokenFile::new(path.clone()).read().unwrap();
    std::fs::remove_file(path).unwrap();
    Server::start_with(ServerConfig { tokens: Some(tokens), ..config() }).await
}

#[tokio::test]
async fn tokens_of_a_list_are_valid_until_they_end() {
    let server = with_token_list("tokens").await;
    let expired = server.request("GET", "/v1/live", &[("Authorization", "Bearer one")]).await;
    assert_eq!(expired.status, 401);
    assert!(expired.json()["detail"].as_str().unwrap().contains("expired"));
    assert_eq!(server.request("GET", "/v1/live", &[("Authorization", "Bearer two")]).await.status, 200);
    assert_eq!(server.metric("tombolo_tokens_refused_total{outcome=\"expired\"}").await, 1.0);
}

#[tokio::test]
async fn an_expired_token_opens_no_session() {
    let server = with_token_list("expired").await;
    // In a header or in an entry beside the subprotocol it is refused before the handshake.
    let entry = |token: &str| format!("tombolo.bearer.{}", BASE64URL_NOPAD.encode(token.as_bytes()));
    for (token, status) in [("one", 401), ("two", 101)] {
        let (given, entry) = (format!("Bearer {token}"), entry(token));
        for header in [("Authorization", given.as_str()), ("Sec-WebSocket-Protocol", entry.as_str())] {
            let reply = server.upgrade(&[header]).await;
            assert_eq!(reply.status, status, "{header:?}");
            if status == 401 {
                assert!(reply.json()["detail"].as_str().unwrap().contains("expired"), "{header:?}");
            }
        }
    }
    // In the Hello it ends the session that had begun.
    let unauthorised = protocol::CloseCode::Unauthorised.code();
    assert_eq!(unauthorised, 4401);
    for (token, code) in [("one", Some(unauthorised)), ("two", None)] {
        let mut request = format!("ws://{}/v1/stream", server.address).into_client_request().unwrap();
        request.headers_mut().insert("Sec-WebSocket-Protocol", protocol::SUBPROTOCOL.parse().unwrap());
        let stream = tokio::net::TcpStream::connect(server.address).await.unwrap();
        let (response, ended) = welcomed(request, stream, Some(token)).await;
        assert_eq!((response.status().as_u16(), ended), (101, code), "{token}");
    }
    assert_eq!(server.metric("tombolo_tokens_refused_total{outcome=\"expired\"}").await, 3.0);
    assert_eq!(server.metric("tombolo_tokens_refused_total{outcome=\"wrong\"}").await, 0.0);
}

#[tokio::test]
async fn routes_that_are_open_with_a_token_are_closed_by_an_option() {
    let open = Server::start_with(with_token()).await;
    let protected = vec![ProtectedRoute::Metrics, ProtectedRoute::World];
    let closed = Server::start_with(ServerConfig { protected, ..with_token() }).await;
    for path in ["/metrics", "/v1/world"] {
        assert_eq!(open.get(path).await.status, 200, "{path}");
        assert_eq!(closed.get(path).await.status, 401, "{path}");
        let given = closed.request("GET", path, &[("Authorization", "Bearer open sesame")]).await;
        assert_eq!(given.status, 200, "{path}");
    }
    for path in ["/", "/page/main.js", "/openapi.json", "/livez", "/readyz"] {
        assert_eq!(closed.get(path).await.status, 200, "{path}");
    }
}

/// Only Linux has further addresses on the loopback device.
#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_address_gets_half_of_the_sessions_and_others_still_some() {
    let server = Server::start_with(ServerConfig { max_sessions: 16, ..config() }).await;
    let mut open = Vec::new();
    let mut counts = [0; 4];
    for (address, count) in (1..).zip(&mut counts) {
        for _ in 0..16 {
            let (status, stream) = server.open_session_from([127, 0, 0, address]).await;
            assert!([101, 503].contains(&status), "{status}");
            *count += usize::from(status == 101);
            open.push(stream);
        }
    }
    assert_eq!(counts, [8, 4, 2, 1]);
    drop(open);

    let all = ServerConfig { max_sessions: 16, max_sessions_per_address: Some(16), ..config() };
    let server = Server::start_with(all).await;
    let mut open = Vec::new();
    for _ in 0..16 {
        let (status, stream) = server.open_session_from([127, 0, 0, 1]).await;
        assert_eq!(status, 101, "the control: the option");
        open.push(stream);
    }
}
