//! CORS (Fetch standard).

use crate::client::Server;

#[tokio::test]
async fn world_routes_allow_all_origins_and_operation_routes_none() {
    let server = Server::start().await;
    let origin = [("Origin", "https://elsewhere.example")];
    for path in [
        server.path("chunk/0/0/0"),
        server.path("map/4/0/0.png"),
        server.path("height/0/0"),
        "/v1/world".into(),
        "/openapi.json".into(),
    ] {
        for headers in [&origin[..], &[]] {
            let reply = server.request("GET", &path, headers).await;
            assert_eq!((reply.status, reply.header("access-control-allow-origin")), (200, "*"), "{path}");
            assert_eq!(reply.header("access-control-expose-headers"), "ETag, Retry-After");
            // `*` excludes credentials.
            assert_eq!(reply.header("access-control-allow-credentials"), "");
        }
    }
    for path in ["/", "/v1/live", "/metrics", "/readyz", "/page/main.js"] {
        let reply = server.request("GET", path, &origin).await;
        assert_eq!((reply.status, reply.header("access-control-allow-origin")), (200, ""), "{path}");
    }
}

#[tokio::test]
async fn rejections_and_304_allow_all_origins_too() {
    let server = Server::start().await;
    let path = server.path("chunk/0/0/0");
    let unchanged = server.request("GET", &path, &[("If-None-Match", "*")]).await;
    assert_eq!((unchanged.status, unchanged.header("access-control-allow-origin")), (304, "*"));
    let refused = server.get(&server.path("chunk/99/0/0")).await;
    assert_eq!((refused.status, refused.header("access-control-allow-origin")), (404, "*"));
    // Rejections before the route.
    for (route, origin) in [(path.as_str(), "*"), ("/v1/live", "")] {
        let misdirected = server.request("GET", route, &[("Host", "elsewhere.example")]).await;
        assert_eq!((misdirected.status, misdirected.header("access-control-allow-origin")), (421, origin));
    }
}

#[tokio::test]
async fn a_preflight_allows_the_methods_and_headers_of_the_routes() {
    let server = Server::start().await;
    let asked = [
        ("Origin", "https://elsewhere.example"),
        ("Access-Control-Request-Method", "GET"),
        ("Access-Control-Request-Headers", "authorization,if-none-match"),
    ];
    let reply = server.request("OPTIONS", &server.path("chunk/0/0/0"), &asked).await;
    assert_eq!((reply.status, reply.body.len()), (204, 0));
    assert_eq!(reply.header("access-control-allow-origin"), "*");
    assert_eq!(reply.header("access-control-allow-methods"), "GET, HEAD");
    let allowed = reply.header("access-control-allow-headers").to_ascii_lowercase();
    // `*` would not cover Authorization: Fetch standard, section 3.3.3.
    assert!(
        ["authorization", "if-none-match", "if-match"].iter().all(|name| allowed.contains(name)),
        "{allowed}"
    );
    assert!(reply.header("access-control-max-age").parse::<u32>().unwrap() > 0);
    let closed = server.request("OPTIONS", "/v1/live", &asked).await;
    assert_eq!((closed.status, closed.header("access-control-allow-methods")), (204, ""));
    assert_eq!(closed.header("allow"), "GET, HEAD, OPTIONS");
}
