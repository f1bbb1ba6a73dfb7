//! Files and policy of the page. The suite `browser` tests its behaviour.

use crate::client::Server;

#[tokio::test]
async fn files_have_their_type_the_policy_and_a_validator() {
    let server = Server::start().await;
    for (path, content_type) in [
        ("/", "text/html; charset=utf-8"),
        ("/page/style.css", "text/css; charset=utf-8"),
        ("/page/main.js", "text/javascript; charset=utf-8"),
        ("/page/icon.svg", "image/svg+xml"),
    ] {
        let reply = server.get(path).await;
        assert_eq!((reply.status, reply.header("content-type")), (200, content_type), "{path}");
        let policy = reply.header("content-security-policy");
        assert!(policy.contains("default-src 'self'") && !policy.contains("unsafe"), "{policy}");
        assert_eq!(reply.header("cache-control"), "no-cache");
        let etag = reply.header("etag").to_owned();
        let again = server.request("GET", path, &[("If-None-Match", &etag)]).await;
        assert_eq!((again.status, again.header("etag")), (304, etag.as_str()), "{path}");
    }
}
