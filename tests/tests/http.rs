//! HTTP: probes, metrics, the description of the world, chunk downloads.

use protocol::chunk_codec;
use terrain::{ChunkKey, Land};
use tests::RunningServer;
use ureq::http::Response;

struct Reply {
    status: u16,
    etag: Option<String>,
    cache: Option<String>,
    body: Vec<u8>,
}

impl Reply {
    fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }
}

async fn get(url: String, known: Option<String>) -> Reply {
    let blocking = move || {
        let agent: ureq::Agent = ureq::Agent::config_builder().http_status_as_error(false).build().into();
        let mut request = agent.get(url);
        if let Some(etag) = known {
            request = request.header("If-None-Match", etag);
        }
        let mut response: Response<ureq::Body> = request.call().unwrap();
        let header =
            |name: &str| response.headers().get(name).map(|value| value.to_str().unwrap().to_owned());
        let (etag, cache) = (header("etag"), header("cache-control"));
        Reply {
            status: response.status().as_u16(),
            etag,
            cache,
            body: response.body_mut().read_to_vec().unwrap(),
        }
    };
    tokio::task::spawn_blocking(blocking).await.unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_downloaded_chunk_is_exact_and_immutable() {
    let server = RunningServer::start().await;
    let land = Land::new(1);
    let key = ChunkKey::new(2, -3, 1).unwrap();
    let url = server.url(&format!("/v1/{}/chunk/{key}", land.digest()));
    let reply = get(url.clone(), None).await;
    assert_eq!(reply.status, 200);
    assert_eq!(chunk_codec::decode(&reply.body, &land.digest()), Ok(land.chunk(key)));
    assert!(reply.cache.unwrap().contains("immutable"));
    let again = get(url.clone(), reply.etag.clone()).await;
    assert_eq!((again.status, again.body.len(), again.etag), (304, 0, reply.etag));
    assert_eq!(get(url, Some("\"other\"".into())).await.status, 200);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn missing_resources_are_404_with_what_exists() {
    let server = RunningServer::start().await;
    let digest = Land::new(1).digest().to_string();
    let zeros = "0".repeat(64);
    for (path, status, word) in [
        (format!("/v1/{digest}/chunk/0/32768/0"), 404, "-32768 to 32767"),
        (format!("/v1/{digest}/chunk/17/0/0"), 404, "0 to 16"),
        (format!("/v1/{digest}/chunk/0/-2147483648/2147483647"), 404, "outside the world"),
        (format!("/v1/{digest}/chunk/0/1.5/0"), 400, "whole numbers"),
        (format!("/v1/{digest}/chunk/0/99999999999/0"), 400, "32-bit"),
        (format!("/v1/{zeros}/chunk/0/0/0"), 404, &digest),
        ("/v1/nonsense/chunk/0/0/0".into(), 404, &digest),
        ("/nowhere".into(), 404, "/v1/world"),
    ] {
        let reply = get(server.url(&path), None).await;
        assert_eq!(reply.status, status, "{path}");
        assert!(reply.text().contains(word), "{path}: {}", reply.text());
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_world_and_the_probes_respond() {
    let server = RunningServer::start().await;
    let world: serde_json::Value =
        serde_json::from_slice(&get(server.url("/v1/world"), None).await.body).unwrap();
    assert_eq!(world["digest"], Land::new(1).digest().to_string());
    assert_eq!((world["world_seed"].as_u64(), world["levels"].as_u64()), (Some(1), Some(17)));
    assert_eq!(world["stream"]["subprotocol"], protocol::SUBPROTOCOL);
    assert_eq!(get(server.url("/livez"), None).await.status, 200);
    assert_eq!(get(server.url("/readyz"), None).await.status, 200);
    let metrics = get(server.url("/metrics"), None).await.text();
    assert!(
        metrics.contains("tombolo_sessions 0")
            && metrics.contains("tombolo_http_responses_total{status=\"200\"} 3"),
        "{metrics}"
    );
    server.stop().await;
}
