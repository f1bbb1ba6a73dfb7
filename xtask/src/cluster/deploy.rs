//! What the files under `deploy/` say of the server: every metric that they use must be in the table
//! of docs/operations.md.

#![cfg(test)]

use std::collections::BTreeSet;

/// The endings that Prometheus adds to the name of a histogram.
const OF_HISTOGRAMS: [&str; 3] = ["_bucket", "_sum", "_count"];

/// The names of metrics in a text.
fn metrics(text: &str) -> BTreeSet<&str> {
    text.split(|c: char| !c.is_ascii_lowercase() && c != '_' && !c.is_ascii_digit())
        .filter(|word| word.starts_with("tombolo_"))
        .map(|word| OF_HISTOGRAMS.iter().find_map(|ending| word.strip_suffix(ending)).unwrap_or(word))
        .collect()
}

/// The names in a text that the table of docs/operations.md lacks.
fn unknown(text: &str) -> Vec<&str> {
    let table = include_str!("../../../docs/operations.md");
    let known: BTreeSet<&str> =
        table.lines().filter_map(|line| line.strip_prefix("| `tombolo_")?.split('`').next()).collect();
    metrics(text).into_iter().filter(|name| !known.contains(&name["tombolo_".len()..])).collect()
}

#[test]
fn alerts_and_dashboard_use_metrics_that_exist() {
    for text in [
        include_str!("../../../deploy/prometheus/alerts.yml"),
        include_str!("../../../deploy/grafana/dashboards/tombolo.json"),
    ] {
        assert!(metrics(text).len() > 5);
        assert_eq!(unknown(text), Vec::<&str>::new());
    }
    // The control: a name that no metric has is found, that of a histogram is not.
    assert_eq!(unknown("rate(tombolo_chunks_lost_total[1m])"), ["tombolo_chunks_lost_total"]);
    assert_eq!(unknown("tombolo_chunk_latency_seconds_bucket"), Vec::<&str>::new());
}

#[test]
fn the_compose_file_mounts_what_exists() {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../");
    let compose = include_str!("../../../docker-compose.yml");
    let mounted: Vec<&str> =
        compose.lines().filter_map(|line| line.trim().strip_prefix("- ./")?.split(':').next()).collect();
    assert!(mounted.len() >= 6, "{mounted:?}");
    for path in mounted {
        assert!(std::path::Path::new(root).join(path).exists(), "{path}");
    }
    // Beyond the loopback a replica starts only with one of its options for that.
    assert!(
        compose.contains("TOMBOLO_TRUSTED_PROXY: ")
            && compose.contains("TOMBOLO_ALLOWED_HOST: replica-1,replica-2")
    );
    let nginx = include_str!("../../../deploy/nginx/nginx.conf");
    assert_eq!(nginx.matches("proxy_set_header Host $http_host;").count(), 2);
    assert_eq!(nginx.matches("proxy_set_header X-Forwarded-For $remote_addr;").count(), 2);
    // All replicas must have the seed of one world.
    assert_eq!(compose.matches("TOMBOLO_WORLD_SEED: ").count(), 1);
    for replica in ["replica-1", "replica-2"] {
        assert!(compose.contains(&format!("  {replica}: *replica")), "{replica}");
        for file in [
            include_str!("../../../deploy/nginx/replicas.conf"),
            include_str!("../../../deploy/prometheus/prometheus.yml"),
        ] {
            assert!(file.contains(&format!("{replica}:7580")), "{replica}");
        }
    }
}
