//! The documents against a real server: routes and the world in `docs/protocol.md`, metrics in
//! `docs/operations.md`, and the values of labels that alerts select.

use crate::client::{Server, UPGRADE, request_over};
use futures_util::{SinkExt, StreamExt};
use protocol::control;
use protocol::delivery::{Delivery, Tolerance};
use protocol::message::{ClientMessage, Hello, ServerMessage, WireKey};
use server::http::routes;
use std::collections::{BTreeMap, BTreeSet};
use tokio::net::TcpStream;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::protocol::Role;

const PROTOCOL: &str = include_str!("../../../docs/protocol.md");
const OPERATIONS: &str = include_str!("../../../docs/operations.md");
const ALERTS: &str = include_str!("../../../deploy/prometheus/alerts.yml");

/// The text from a heading to the next one of its rank or a higher one.
fn section<'a>(document: &'a str, heading: &str) -> &'a str {
    let start = document.find(&format!("\n{heading}")).unwrap_or_else(|| panic!("{heading}")) + 1;
    let rank = heading.bytes().take_while(|byte| *byte == b'#').count();
    let rest = &document[start + rank..];
    let ends = (1..=rank).filter_map(|rank| rest.find(&format!("\n{} ", "#".repeat(rank))));
    &rest[..ends.min().unwrap_or(rest.len())]
}

/// The cells of the rows of the tables in a text, heads and rules aside.
fn rows(text: &str) -> Vec<Vec<&str>> {
    let lines = text.lines().filter(|line| line.starts_with("| `"));
    lines.map(|line| line.trim_matches('|').split('|').map(str::trim).collect()).collect()
}

/// What is between backticks.
fn quoted(text: &str) -> BTreeSet<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

#[test]
fn the_section_of_http_names_the_routes_of_the_router() {
    let section = section(PROTOCOL, "## 7. HTTP");
    let served: BTreeSet<&str> = routes().iter().map(|route| route.path).collect();
    let path = |name: &'static str| name.strip_prefix("GET ").unwrap_or(name).trim_end_matches(".png");
    let named: BTreeSet<&str> = quoted(section).into_iter().map(path).collect();
    assert_eq!(served.difference(&named).collect::<Vec<_>>(), Vec::<&&str>::new(), "not in the document");
    let gets = quoted(section).into_iter().filter(|name| name.starts_with("GET /")).map(path);
    let gets: BTreeSet<&str> = gets.collect();
    assert_eq!(gets, served);
    // The router knows no suffix: both documents have to name it.
    assert!(section.contains("`GET /v1/{digest}/map/{level}/{x}/{z}.png`"));
    let openapi: serde_json::Value = serde_json::from_str(server::http::openapi::DOCUMENT).unwrap();
    let tile = &openapi["paths"]["/v1/{digest}/map/{level}/{x}/{z}"]["get"]["parameters"];
    let z = tile.as_array().unwrap().iter().find(|parameter| parameter["name"] == "z").unwrap();
    assert!(z["schema"]["pattern"].as_str().unwrap().contains(".png"), "{z}");
    assert!(section.contains("each axis from -4,194,304 to 4,194,303, else 404"), "the range of heights");
}

#[tokio::test]
async fn the_table_of_the_world_has_the_fields_of_the_answer() {
    let rows = rows(section(PROTOCOL, "### 7.4 The world"));
    let fields = |json: &serde_json::Value| -> BTreeSet<String> {
        json.as_object().unwrap().keys().cloned().collect()
    };
    let documented = |names: &BTreeSet<&str>| names.iter().map(|name| (*name).to_owned()).collect();
    let names: BTreeSet<&str> = rows[1..].iter().flat_map(|row| quoted(row[0])).collect();
    assert_eq!(rows[0][0], "`server`", "the first row of the table");
    let names = &names | &quoted(rows[0][0]);
    let world = Server::start().await.get("/v1/world").await.json();
    assert_eq!(fields(&world), documented(&names));
    let stream = rows.iter().find(|row| row[0] == "`stream`").unwrap();
    assert_eq!(fields(&world["stream"]), documented(&quoted(stream[1])));
}

/// A family of metrics: its type, and the values of its labels.
#[derive(Debug, Default, PartialEq)]
struct Family {
    kind: String,
    labels: BTreeMap<String, BTreeSet<String>>,
}

/// The families of a rendered text, by the names that their samples have.
fn rendered(text: &str) -> BTreeMap<String, Family> {
    let mut families = BTreeMap::<String, Family>::new();
    let (mut current, mut with_samples) = (String::new(), BTreeSet::new());
    for line in text.lines() {
        if let Some(declared) = line.strip_prefix("# TYPE ") {
            let (name, kind) = declared.split_once(' ').unwrap();
            let ending = match kind {
                "counter" => "_total",
                "info" => "_info",
                _ => "",
            };
            current = format!("{name}{ending}");
            families.insert(current.clone(), Family { kind: kind.into(), ..Family::default() });
        } else if !line.starts_with('#') {
            let name = line.split(['{', ' ']).next().unwrap();
            assert!(name.starts_with(&current), "{line} is not of {current}");
            with_samples.insert(current.clone());
            let family = families.get_mut(&current).unwrap();
            let labels = line.split_once('{').map_or("", |(_, rest)| rest.split('}').next().unwrap());
            for label in labels.split(',').filter(|label| !label.is_empty()) {
                let (label, value) = label.split_once('=').unwrap();
                // The limits of a histogram's buckets.
                if label != "le" {
                    family.labels.entry(label.into()).or_default().insert(value.trim_matches('"').into());
                }
            }
        }
    }
    let silent: Vec<_> = families.keys().filter(|name| !with_samples.contains(*name)).collect();
    assert!(silent.is_empty(), "without a sample their labels are unknown: {silent:?}");
    families
}

/// The metrics of a server that has sent a chunk over a session, so that every family has a sample.
async fn metrics() -> BTreeMap<String, Family> {
    let server = Server::start().await;
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    assert_eq!(request_over(&mut stream, "GET", "/v1/stream", &UPGRADE).await.status, 101);
    let mut socket = WebSocketStream::from_raw_socket(stream, Role::Client, None).await;
    let hello = Hello { digest: None, delivery: Delivery::Exact, token: None, software: "test".into() };
    let keys = vec![WireKey { level: 0, x: 0, z: 0 }];
    for message in [
        ClientMessage::Hello(hello),
        ClientMessage::Credit { chunks: 1 },
        ClientMessage::Request { id: 1, keys },
    ] {
        socket.send(Message::Binary(control::encode(&message).unwrap())).await.unwrap();
    }
    loop {
        let Message::Binary(bytes) = socket.next().await.unwrap().unwrap() else { continue };
        if control::decode::<ServerMessage>(&bytes).is_err() {
            break;
        }
    }
    // The chunk is counted after its write.
    while server.metric("tombolo_session_sent_bytes_total").await == 0.0
        || !String::from_utf8(server.get("/metrics").await.body).unwrap().contains("delivery=\"exact\"")
    {
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
    rendered(&String::from_utf8(server.get("/metrics").await.body).unwrap())
}

/// The rows of the table of metrics, by their name.
fn documented() -> BTreeMap<&'static str, Vec<&'static str>> {
    let rows = rows(section(OPERATIONS, "## Metrics"));
    let metrics = rows.into_iter().filter(|row| row[0].starts_with("`tombolo_"));
    metrics.map(|row| (row[0].trim_matches('`'), row)).collect()
}

#[tokio::test]
async fn the_table_of_metrics_agrees_with_what_a_server_renders() {
    let (rendered, documented) = (metrics().await, documented());
    let names = |names: &mut dyn Iterator<Item = &str>| names.map(String::from).collect::<BTreeSet<_>>();
    assert_eq!(
        names(&mut documented.keys().copied()),
        names(&mut rendered.keys().map(String::as_str)),
        "documented, rendered"
    );
    let deliveries =
        [Delivery::Exact, Delivery::SeedOnly, Delivery::Refined, Delivery::Quantised(Tolerance::COARSEST)];
    for (name, row) in documented {
        let family = &rendered[name];
        assert_eq!(row[1], family.kind, "{name}");
        assert_eq!(
            names(&mut quoted(row[2]).into_iter()),
            names(&mut family.labels.keys().map(String::as_str)),
            "{name}"
        );
        let words: BTreeSet<&str> = quoted(row[3]);
        let is_value = |word: &&str| {
            word.bytes().all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_')
        };
        let values: BTreeSet<&str> = words.into_iter().filter(is_value).collect();
        if family.labels.is_empty() || values.is_empty() {
            continue;
        }
        let of_server: BTreeSet<&str> = if family.labels.contains_key("delivery") {
            // Each is a value once a session has asked for it.
            deliveries.into_iter().map(Delivery::name).collect()
        } else {
            family.labels.values().flatten().map(String::as_str).collect()
        };
        assert!(values.is_subset(&of_server), "{name}: {values:?}, {of_server:?}");
        // A list that is not cut short has them all.
        assert!(row[3].contains("...") || values == of_server, "{name}: {values:?}, {of_server:?}");
    }
}

/// The selections of labels in a text: metric, label, and a value. A pattern has several.
fn selections(text: &str) -> Vec<(&str, &str, &str)> {
    let mut found = Vec::new();
    for (at, _) in text.match_indices("tombolo_") {
        let rest = &text[at..];
        let length = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(rest.len());
        let (name, rest) = rest.split_at(length);
        let Some((matchers, _)) = rest.strip_prefix('{').and_then(|rest| rest.split_once('}')) else {
            continue;
        };
        for matcher in matchers.split(',') {
            let (label, values) = matcher.split_once(['=', '!']).unwrap();
            let values = values.trim_start_matches(['=', '~']).trim_matches('"');
            found.extend(values.split('|').map(|value| (name, label.trim(), value)));
        }
    }
    found
}

#[tokio::test]
async fn alerts_select_values_that_labels_have() {
    let rendered = metrics().await;
    let exists = |(name, label, value): &(&str, &str, &str)| {
        let values = rendered.get(*name).and_then(|family| family.labels.get(*label));
        values.is_some_and(|values| values.contains(*value))
    };
    let selected = selections(ALERTS);
    assert!(selected.len() > 10, "{selected:?}");
    let unknown: Vec<_> = selected.iter().filter(|selection| !exists(selection)).collect();
    assert!(unknown.is_empty(), "{unknown:?}");
    // The controls: another value, another label, and one value of a pattern are found.
    for wrong in [
        "tombolo_store_reads_total{outcome=\"tardy\"}",
        "tombolo_store_reads_total{reason=\"late\"}",
        "tombolo_store_writes_total{outcome=~\"failed|refuse\"}",
        "tombolo_sessions_ended_total{reason!~\"closed|drain\"}",
    ] {
        assert!(!selections(wrong).iter().all(exists), "{wrong}");
    }
}
