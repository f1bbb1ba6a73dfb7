//! The description of the world.

use crate::client::Server;
use server::ServerConfig;
use terrain::Land;

#[tokio::test]
async fn a_seed_beyond_what_javascript_counts_exactly_is_stated_as_text() {
    for seed in [1, (1 << 53) + 1, u64::MAX] {
        let server =
            Server::start_with(ServerConfig { threads: 1, world_seed: seed, ..ServerConfig::default() })
                .await;
        let reply = server.get("/v1/world").await;
        assert_eq!(reply.status, 200);
        let world: serde_json::Value = serde_json::from_slice(&reply.body).unwrap();
        assert_eq!(world["world_seed_text"], seed.to_string());
        assert_eq!(world["digest"], Land::new(seed).digest().to_string());
        // What a reader of numbers with 53 bits makes of the other field is another seed.
        let as_float = world["world_seed"].as_f64().unwrap() as u128;
        assert_eq!(as_float == u128::from(seed), seed == 1);
        server.stop().await;
    }
}
