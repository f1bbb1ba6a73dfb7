//! What the files under `deploy/` say of the server: every metric that they use must be in the
//! table of docs/operations.md, every variable that they set must be an option's.

#![cfg(test)]

use crate::process;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The endings that Prometheus adds to the name of a histogram.
const OF_HISTOGRAMS: [&str; 3] = ["_bucket", "_sum", "_count"];

/// Variables of the deployment that are no option of the server, and why each is there.
const NO_OPTIONS: [(&str, &str); 1] =
    [("TOMBOLO_HOST", "docker-compose.yml puts its value into TOMBOLO_ALLOWED_HOST")];

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
        assert!(Path::new(root).join(path).exists(), "{path}");
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

/// The files in a folder and the folders below; of a file, itself.
fn files(path: &Path) -> Vec<PathBuf> {
    if path.is_file() {
        return vec![path.to_owned()];
    }
    let entries = std::fs::read_dir(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    entries.flat_map(|entry| files(&entry.unwrap().path())).collect()
}

/// The text of files and folders of the repository.
fn texts(paths: &[&str]) -> String {
    let all = paths.iter().flat_map(|path| files(&process::root().join(path)));
    // A line break between two: the last word of one is not continued by the next.
    all.map(|file| std::fs::read_to_string(file).unwrap() + "\n").collect()
}

/// The names of the server's variables in a text.
fn variables(text: &str) -> BTreeSet<&str> {
    text.split(|c: char| !c.is_ascii_uppercase() && c != '_' && !c.is_ascii_digit())
        .filter(|word| word.starts_with("TOMBOLO_"))
        .collect()
}

/// A misspelt variable is no error of a server: it starts with the default of the option.
#[test]
fn variables_of_the_deployment_are_options_of_the_server() {
    let options = texts(&["server/src/config/options.rs", "server/src/bake.rs", "server/src/bake"]);
    let options: BTreeSet<&str> =
        options.split("env = \"").skip(1).filter_map(|rest| rest.split('"').next()).collect();
    assert!(options.len() > 20 && options.contains("TOMBOLO_WORLD_SEED"), "{options:?}");
    let given = texts(&["docker-compose.yml", "Dockerfile", "deploy"]);
    let unknown = |text: &str| -> Vec<String> {
        variables(text).into_iter().filter(|name| !options.contains(name)).map(String::from).collect()
    };
    assert!(variables(&given).len() > 8, "{:?}", variables(&given));
    // Each exception is used, and none hides an option.
    assert_eq!(unknown(&given), NO_OPTIONS.map(|(name, _)| name));
    // The controls: a misspelt variable is found in each of the three notations.
    for text in
        ["TOMBOLO_CACH_MB: \"512\"", "{ name: TOMBOLO_CACH_MB, value: \"512\" }", "ENV TOMBOLO_CACH_MB=512"]
    {
        assert_eq!(unknown(text), ["TOMBOLO_CACH_MB"]);
    }
}
