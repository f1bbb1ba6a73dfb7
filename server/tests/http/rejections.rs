//! Problem documents and their metrics.

use crate::client::{Server, UPGRADE, read_all};
use server::ServerConfig;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;

async fn rejected(server: &Server, kind: &str) -> u64 {
    let text = String::from_utf8(server.get("/metrics").await.body).unwrap();
    let name = format!(
        "tombolo_requests_rejected_total{{transport=\"http\",reason=\"{}\"}} ",
        kind.replace('-', "_")
    );
    let line = text.lines().find_map(|line| line.strip_prefix(&name));
    line.unwrap_or_else(|| panic!("{name} is not in {text}")).parse().unwrap()
}

#[tokio::test]
async fn an_invalid_path_is_rejected_with_its_kind_and_counted() {
    let server = Server::start().await;
    let other = format!("/v1/{}", "0".repeat(64));
    let capitals = |rest: &str| {
        let path = server.path(rest);
        let digest = path.split('/').nth(2).unwrap();
        path.replace(digest, &digest.to_uppercase())
    };
    for (path, status, kind, word) in [
        (server.path("chunk/0/32768/0"), 404, "outside-world", "-32768 to 32767"),
        (server.path("map/0/32768/0.png"), 404, "outside-world", "-32768 to 32767"),
        (server.path("map/17/0/0.png"), 404, "outside-world", "0 to 16"),
        (server.path("map/255/0/0.png"), 404, "outside-world", "0 to 16"),
        (server.path("map/256/0/0.png"), 400, "malformed", "0 to 255"),
        (server.path("map/0/0/0"), 404, "no-route", ".png"),
        (server.path("map/0/0/.png"), 400, "malformed", "whole numbers"),
        (server.path("map/0/0/99999999999.png"), 400, "malformed", "32-bit"),
        (server.path("map/-1/0/0.png"), 400, "malformed", "whole numbers"),
        (server.path("chunk/0/%FF/0"), 400, "malformed", "UTF-8"),
        (server.path("chunk/0/1e3/0"), 400, "malformed", "whole numbers"),
        (server.path("chunk/0/+1/0"), 400, "malformed", "shortest form"),
        (server.path("chunk/00/1/0"), 400, "malformed", "shortest form"),
        (server.path("map/0/-0/0.png"), 400, "malformed", "shortest form"),
        (server.path("chunk/0/%30/0"), 400, "malformed", "percent-encoded"),
        (server.path("map/0/0/%30.png"), 400, "malformed", "percent-encoded"),
        (server.path("map/0/0/0%2Epng"), 400, "malformed", "percent-encoded"),
        (server.path("height/%30/0"), 400, "malformed", "percent-encoded"),
        (server.path("chunk/0/0/0?x=1"), 400, "malformed", "no query"),
        (server.path("chunk/0/0/0?"), 400, "malformed", "no query"),
        (server.path("height/0/0?x=1"), 400, "malformed", "no query"),
        (server.path("map/0/0/0.png?x=1"), 400, "malformed", "style=N"),
        (server.path("map/0/0/0.png?style=1&x=1"), 400, "malformed", "style=N"),
        (server.path("map/0/0/0.png?style=01"), 400, "malformed", "style=N"),
        (server.path("map/0/0/0.png?style=%31"), 400, "malformed", "style=N"),
        (server.path("map/0/0/0.png?style=0"), 404, "wrong-style", "this server has style 1"),
        (server.path("map/0/0/0.png?style=2"), 404, "wrong-style", "this server has style 1"),
        (server.path("height/+1/0"), 400, "malformed", "shortest form"),
        (server.path("height/1/007"), 400, "malformed", "shortest form"),
        (capitals("chunk/0/0/0"), 400, "malformed", "lower case"),
        (capitals("map/0/0/0.png"), 400, "malformed", "lower case"),
        (capitals("height/0/0"), 400, "malformed", "lower case"),
        (server.path("height/4194304/0"), 404, "outside-world", "-4194304 to 4194303"),
        (server.path("height/-2147483648/0"), 404, "outside-world", "outside the world"),
        (server.path("height/1.5/0"), 400, "malformed", "whole metres"),
        (server.path("height/%FF/0"), 400, "malformed", "UTF-8"),
        (format!("{other}/map/0/0/0.png"), 404, "wrong-world", "is not served here"),
        (format!("{other}/height/0/0"), 404, "wrong-world", "is not served here"),
        ("/v1/nonsense/chunk/0/0/0".into(), 404, "wrong-world", "nonsense"),
        ("/page/no-such.js".into(), 404, "no-route", "begins at /"),
        ("/page/%FF".into(), 404, "no-route", "begins at /"),
        ("/page/..%2Fhttp%2Fmod.rs".into(), 404, "no-route", "begins at /"),
        ("/nowhere".into(), 404, "no-route", "/openapi.json"),
    ] {
        let before = rejected(&server, kind).await;
        let reply = server.get(&path).await;
        assert_eq!((reply.status, reply.problem().as_str()), (status, kind), "{path}");
        let detail = reply.json()["detail"].as_str().unwrap().to_owned();
        assert!(detail.contains(word) && !detail.contains('\n'), "{path}: {detail}");
        assert_eq!(reply.header("cache-control"), "no-store");
        assert_eq!(rejected(&server, kind).await, before + 1, "{path}");
    }
    // Other requests are not affected.
    for path in ["chunk/0/0/0", "map/0/0/0.png", "map/0/0/0.png?style=1", "height/-7/0"] {
        assert_eq!(server.get(&server.path(path)).await.status, 200, "{path}");
    }
}

#[tokio::test]
async fn an_unsupported_method_is_rejected_with_allow() {
    let server = Server::start().await;
    for path in ["/", "/v1/live", "/v1/world", &server.path("chunk/0/0/0"), &server.path("map/0/0/0.png")] {
        for method in ["POST", "PUT", "DELETE", "PATCH"] {
            let reply = server.request(method, path, &[("Content-Length", "0")]).await;
            assert_eq!((reply.status, reply.problem().as_str()), (405, "wrong-method"), "{method} {path}");
            assert_eq!(reply.header("allow"), "GET, HEAD, OPTIONS", "{method} {path}");
        }
    }
    let stream = server.request("POST", "/v1/stream", &[("Content-Length", "0")]).await;
    assert_eq!(
        (stream.status, stream.problem().as_str(), stream.header("allow")),
        (405, "wrong-method", "GET")
    );
}

#[tokio::test]
async fn an_overloaded_server_sends_retry_after() {
    let config = ServerConfig { max_jobs: Some(0), threads: 1, max_sessions: 1, ..ServerConfig::default() };
    let server = Server::start_with(config).await;
    for path in [server.path("chunk/0/0/0"), server.path("map/0/0/0.png")] {
        let reply = server.get(&path).await;
        assert_eq!((reply.status, reply.problem().as_str()), (503, "overloaded"), "{path}");
        assert_eq!(reply.header("retry-after"), "1");
    }
    // Routes without chunks are not affected.
    assert_eq!(server.get(&server.path("height/0/0")).await.status, 200);
    assert_eq!(server.get("/").await.status, 200);
}

#[tokio::test]
async fn the_rate_limit_applies_on_an_idle_server() {
    let config = ServerConfig { threads: 1, rate_limit_ms: Some(1), ..ServerConfig::default() };
    let server = Server::start_with(config).await;
    let mut served = 0;
    // The bucket holds ten milliseconds and gains one per second; a chunk costs one or more.
    let rejected = loop {
        let reply = server.get(&server.path(&format!("chunk/4/{served}/-1"))).await;
        if reply.status != 200 {
            break reply;
        }
        served += 1;
        assert!(served < 200, "the bucket is never empty");
    };
    assert!(served > 0);
    assert_eq!((rejected.status, rejected.problem().as_str()), (503, "over-rate"));
    assert_eq!(rejected.header("retry-after"), "1");
    // If the bucket has refilled meanwhile, the first tiles empty it.
    let mut tile = server.get(&server.path("map/4/9/9.png")).await;
    for x in 10..200 {
        if tile.status != 200 {
            break;
        }
        tile = server.get(&server.path(&format!("map/4/{x}/9.png"))).await;
    }
    assert_eq!((tile.status, tile.problem().as_str()), (503, "over-rate"), "tiles are charged too");
    assert!(server.metric("tombolo_rate_limited_total{outcome=\"rejected\"}").await >= 2.0);
    assert_eq!(server.get("/v1/world").await.status, 200, "other routes are not limited");

    let free = Server::start_with(ServerConfig { threads: 1, ..ServerConfig::default() }).await;
    for x in 0..=served {
        assert_eq!(free.get(&free.path(&format!("chunk/4/{x}/-1"))).await.status, 200, "the control");
    }
}

#[tokio::test]
async fn a_session_that_is_asked_for_while_the_server_shuts_down_is_rejected_with_that_reason() {
    let server = Server::start().await;
    let request: String =
        UPGRADE.iter().fold("GET /v1/stream HTTP/1.1\r\nHost: localhost\r\n".into(), |text, header| {
            format!("{text}{}: {}\r\n", header.0, header.1)
        });
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    stream.write_all(request.as_bytes()).await.unwrap();
    // The answer to a later connection shows that the server has the first one.
    assert_eq!(server.get("/livez").await.status, 200);
    let address = server.address;
    let rest = async {
        // A server that shuts down no longer listens.
        while TcpStream::connect(address).await.is_ok() {}
        stream.write_all(b"\r\n").await.unwrap();
        String::from_utf8(read_all(stream).await).unwrap()
    };
    let (reply, ()) = tokio::join!(rest, server.stop());
    assert!(reply.starts_with("HTTP/1.1 503 "), "{reply}");
    assert!(reply.contains("/no-session") && reply.contains("shutting down"), "{reply}");
}
