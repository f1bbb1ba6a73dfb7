//! Typed refusals, counted by kind, and that nothing else suffers.

use crate::client::Server;
use server::ServerConfig;

async fn counted(server: &Server, kind: &str) -> u64 {
    let text = String::from_utf8(server.get("/metrics").await.body).unwrap();
    let name = format!("tombolo_http_refusals_total{{reason=\"{kind}\"}} ");
    let line = text.lines().find_map(|line| line.strip_prefix(&name));
    line.unwrap_or_else(|| panic!("{name} is not in {text}")).parse().unwrap()
}

#[tokio::test]
async fn every_bad_address_is_refused_by_its_kind_and_counted() {
    let server = Server::start().await;
    let other = format!("/v1/{}", "0".repeat(64));
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
        let before = counted(&server, kind).await;
        let reply = server.get(&path).await;
        assert_eq!((reply.status, reply.problem().as_str()), (status, kind), "{path}");
        let detail = reply.json()["detail"].as_str().unwrap().to_owned();
        assert!(detail.contains(word) && !detail.contains('\n'), "{path}: {detail}");
        assert_eq!(reply.header("cache-control"), "no-store");
        assert_eq!(counted(&server, kind).await, before + 1, "{path}");
    }
    // Unharmed.
    assert_eq!(server.get(&server.path("chunk/0/0/0")).await.status, 200);
}

#[tokio::test]
async fn other_methods_are_refused_with_the_ones_that_are_allowed() {
    let server = Server::start().await;
    for path in ["/", "/v1/live", "/v1/world", &server.path("chunk/0/0/0"), &server.path("map/0/0/0.png")] {
        for method in ["POST", "PUT", "DELETE", "PATCH"] {
            let reply = server.ask(method, path, &[("Content-Length", "0")]).await;
            assert_eq!((reply.status, reply.problem().as_str()), (405, "wrong-method"), "{method} {path}");
            assert_eq!(reply.header("allow"), "GET, HEAD, OPTIONS", "{method} {path}");
        }
    }
    let door = server.ask("POST", "/v1/stream", &[("Content-Length", "0")]).await;
    assert_eq!((door.status, door.problem().as_str(), door.header("allow")), (405, "wrong-method", "GET"));
}

#[tokio::test]
async fn an_overloaded_server_says_when_to_come_back() {
    let config = ServerConfig { max_jobs: 0, threads: 1, max_sessions: 1, ..ServerConfig::default() };
    let server = Server::start_with(config).await;
    for path in [server.path("chunk/0/0/0"), server.path("map/0/0/0.png")] {
        let reply = server.get(&path).await;
        assert_eq!((reply.status, reply.problem().as_str()), (503, "overloaded"), "{path}");
        assert_eq!(reply.header("retry-after"), "1");
    }
    // What needs no chunk is there.
    assert_eq!(server.get(&server.path("height/0/0")).await.status, 200);
    assert_eq!(server.get("/").await.status, 200);
}

#[tokio::test]
async fn an_address_that_has_spent_what_it_may_cost_is_refused_though_nobody_else_asks() {
    let config = ServerConfig { threads: 1, cost_per_second: Some(1), ..ServerConfig::default() };
    let server = Server::start_with(config).await;
    let mut served = 0;
    // Ten milliseconds are in the purse, a chunk costs one or more, and a millisecond comes each
    // second.
    let refused = loop {
        let reply = server.get(&server.path(&format!("chunk/4/{served}/-1"))).await;
        if reply.status != 200 {
            break reply;
        }
        served += 1;
        assert!(served < 200, "the purse has no bottom");
    };
    assert!(served > 0);
    assert_eq!((refused.status, refused.problem().as_str()), (503, "overloaded"));
    assert_eq!(refused.header("retry-after"), "1");
    // Should enough have come in this moment, the first of them spends it many times over.
    server.get(&server.path("map/4/9/9.png")).await;
    let tile = server.get(&server.path("map/4/19/9.png")).await;
    assert_eq!((tile.status, tile.problem().as_str()), (503, "overloaded"), "tiles cost too");
    assert!(server.metric("tombolo_cost_refusals_total").await >= 2.0);
    assert_eq!(server.get("/v1/world").await.status, 200, "what costs nothing is for all");

    let free = Server::start_with(ServerConfig { threads: 1, ..ServerConfig::default() }).await;
    for x in 0..=served {
        assert_eq!(free.get(&free.path(&format!("chunk/4/{x}/-1"))).await.status, 200, "the control");
    }
}
