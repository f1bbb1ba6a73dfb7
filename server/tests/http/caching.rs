//! Validators, conditional requests and `Cache-Control`: RFC 9110 and RFC 9111.

use crate::client::Server;
use protocol::chunk_codec::{self, seed_only};
use server::ServerConfig;
use server::access::tokens::TokenSet;
use terrain::constants::TOP_LEVEL;
use terrain::{ChunkKey, Land};

const IMMUTABLE: &str = "public, max-age=31536000, immutable";

#[tokio::test]
async fn immutable_resources_have_a_strong_validator() {
    let server = Server::start().await;
    for path in [server.path("chunk/2/-3/1"), server.path("map/3/0/-1.png")] {
        let first = server.get(&path).await;
        let etag = first.header("etag").to_owned();
        assert_eq!((first.status, first.header("cache-control")), (200, IMMUTABLE), "{path}");
        assert!(etag.starts_with('"') && etag.ends_with('"') && etag.len() == 34, "{etag}");
        for known in [etag.as_str(), &format!("W/{etag}"), &format!("\"x\", {etag}"), "*", " * "] {
            let again = server.request("GET", &path, &[("If-None-Match", known)]).await;
            assert_eq!((again.status, again.body.len()), (304, 0), "{known}");
            // RFC 9110, section 15.4.5: the headers of the corresponding 200.
            assert_eq!((again.header("etag"), again.header("cache-control")), (etag.as_str(), IMMUTABLE));
        }
        let two_lines = [("If-None-Match", "\"x\""), ("If-None-Match", etag.as_str())];
        assert_eq!(server.request("GET", &path, &two_lines).await.status, 304);
        assert_eq!(server.request("GET", &path, &[("If-None-Match", "\"x\"")]).await.status, 200);
        assert_eq!(server.request("GET", &path, &[("If-Match", &etag)]).await.status, 200);
        let failed = server.request("GET", &path, &[("If-Match", "\"x\"")]).await;
        assert_eq!((failed.status, failed.problem().as_str()), (412, "precondition-failed"));
        // `If-Match` takes precedence: RFC 9110, section 13.2.2.
        let both = [("If-Match", "\"x\""), ("If-None-Match", etag.as_str())];
        assert_eq!(server.request("GET", &path, &both).await.status, 412);
        assert_eq!(server.get(&path).await.body, first.body, "the same bytes under the same validator");
    }
    let (one, other) = (server.path("chunk/0/0/0"), server.path("chunk/0/0/1"));
    assert_ne!(server.get(&one).await.header("etag"), server.get(&other).await.header("etag"));
}

/// Replicas behind one cache agree on every address, whatever else they are doing.
#[tokio::test]
async fn the_etag_is_the_digest_of_the_content_on_every_server() {
    let (idle, busy) = (Server::start().await, Server::start().await);
    let land = Land::new(ServerConfig::default().world_seed);
    let load: Vec<_> = (0..400).map(|n| busy.path(&format!("chunk/0/{}/{}", n % 20, n / 20))).collect();
    let mut load = std::pin::pin!(futures_util::future::join_all(load.iter().map(|path| busy.get(path))));
    let checks = async {
        for level in 0..=TOP_LEVEL {
            let key = ChunkKey::new(level, 0, 0).unwrap();
            let content = seed_only::digest(&land.chunk(key), &land.digest());
            let etag: String = content.iter().map(|byte| format!("{byte:02x}")).collect();
            for server in [&idle, &busy, &idle] {
                let reply = server.get(&server.path(&format!("chunk/{level}/0/0"))).await;
                assert_eq!(
                    (reply.status, reply.header("etag")),
                    (200, format!("\"{etag}\"").as_str()),
                    "{key}"
                );
                // The control: the digest in the frame is another one, of the encoded bytes.
                assert!(!reply.body.windows(16).any(|bytes| bytes == content), "{key}");
                assert_eq!(chunk_codec::decode(&reply.body, &land.digest()).unwrap(), land.chunk(key));
            }
        }
    };
    let replies = futures_util::future::join(&mut load, checks).await.0;
    assert!(replies.iter().all(|reply| [200, 503].contains(&reply.status)));
}

#[tokio::test]
async fn a_head_response_is_a_get_response_without_its_body() {
    let server = Server::start().await;
    for path in [
        server.path("chunk/0/1/1"),
        server.path("map/5/0/0.png"),
        server.path("height/3/4"),
        "/".into(),
        "/page/main.js".into(),
        "/openapi.json".into(),
        "/v1/world".into(),
        "/livez".into(),
        "/readyz".into(),
    ] {
        let (get, head) = (server.get(&path).await, server.request("HEAD", &path, &[]).await);
        assert_eq!((get.status, head.status, head.body.len()), (200, 200, 0), "{path}");
        assert_eq!(head.header("content-length"), get.body.len().to_string(), "{path}");
        for name in ["etag", "content-type", "cache-control", "x-content-type-options"] {
            assert_eq!(head.header(name), get.header(name), "{path} {name}");
        }
        assert_eq!(get.header("x-content-type-options"), "nosniff");
    }
    let path = server.path("chunk/0/1/1");
    let etag = server.get(&path).await.header("etag").to_owned();
    assert_eq!(server.request("HEAD", &path, &[("If-None-Match", &etag)]).await.status, 304);
    assert_eq!(server.request("HEAD", &server.path("chunk/17/0/0"), &[]).await.status, 404);
}

#[tokio::test]
async fn resources_that_require_a_token_are_private() {
    let config =
        ServerConfig { tokens: Some(TokenSet::one("sesame")), threads: 1, ..ServerConfig::default() };
    let server = Server::start_with(config).await;
    for path in [
        server.path("chunk/0/0/0"),
        server.path("map/0/0/0.png"),
        server.path("height/0/0"),
        "/v1/live".into(),
    ] {
        let locked = server.get(&path).await;
        assert_eq!((locked.status, locked.problem().as_str()), (401, "unauthorised"), "{path}");
        assert_eq!(locked.header("www-authenticate"), "Bearer");
        assert_eq!(server.request("GET", &path, &[("Authorization", "Bearer other")]).await.status, 401);
        // The scheme is case-insensitive, the token is not.
        assert_eq!(server.request("GET", &path, &[("Authorization", "Bearer SESAME")]).await.status, 401);
        for scheme in ["Bearer", "bearer", "BEARER"] {
            let given = format!("{scheme} sesame");
            let open = server.request("GET", &path, &[("Authorization", &given)]).await;
            assert_eq!(open.status, 200, "{path} {scheme}");
            // `public` would let a shared cache serve it without the token: RFC 9111, section 3.5.
            assert!(!open.header("cache-control").contains("public"), "{}", open.header("cache-control"));
        }
        // A conditional request reveals nothing without the token.
        assert_eq!(server.request("GET", &path, &[("If-None-Match", "*")]).await.status, 401);
    }
    assert_eq!(server.get("/v1/world").await.json()["takes_token"], true);
}
