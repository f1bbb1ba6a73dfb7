//! The OpenAPI document against the server: routes, problem kinds, and the status of real
//! responses.

use crate::client::{Reply, Server, UPGRADE};
use serde_json::{Map, Value};
use server::ServerConfig;
use server::access::ProtectedRoute;
use server::access::tokens::TokenSet;
use server::http::openapi::DOCUMENT;
use server::http::problem::ProblemKind;
use server::http::routes;
use std::collections::BTreeSet;

/// The first answer to many different tokens that does not say that the token is wrong.
async fn guess(server: &Server, path: &str, headers: &[(&str, &str)]) -> Reply {
    for guess in 0..100 {
        let token = format!("Bearer {guess} for {path}");
        let reply = server.request("GET", path, &[headers, &[("Authorization", &token)]].concat()).await;
        if reply.status != 401 {
            return reply;
        }
    }
    panic!("guesses are not throttled");
}

fn document() -> Value {
    serde_json::from_str(DOCUMENT).unwrap()
}

fn paths(document: &Value) -> &Map<String, Value> {
    document["paths"].as_object().unwrap()
}

#[test]
fn the_document_lists_the_routes_of_the_router() {
    let document = document();
    let documented: Vec<_> = paths(&document).keys().map(String::as_str).collect();
    let served: Vec<_> = routes().iter().map(|route| route.path).collect();
    let sorted = |list: &[&str]| list.iter().map(|path| (*path).to_owned()).collect::<BTreeSet<_>>();
    assert_eq!(sorted(&documented), sorted(&served));
}

#[test]
fn references_resolve_and_path_parameters_are_described() {
    let document = document();
    assert_eq!(document["openapi"], "3.1.1");
    let mut references = 0;
    each(&document, &mut |value| {
        if let Some(reference) = value.get("$ref").and_then(Value::as_str) {
            references += 1;
            let pointer = reference.strip_prefix('#').expect("within the document");
            assert!(document.pointer(pointer).is_some(), "{reference}");
        }
    });
    assert!(references > 50, "{references}");
    let mut names = BTreeSet::new();
    for (path, item) in paths(&document) {
        let operation = &item["get"];
        assert!(names.insert(operation["operationId"].as_str().unwrap()), "{path}");
        assert!(!operation["summary"].as_str().unwrap().is_empty());
        let described: BTreeSet<&str> = operation["parameters"]
            .as_array()
            .map_or(&[][..], Vec::as_slice)
            .iter()
            .map(|parameter| match parameter.get("$ref").and_then(Value::as_str) {
                Some(reference) => document.pointer(&reference[1..]).unwrap(),
                None => parameter,
            })
            .filter(|parameter| parameter["in"] == "path")
            .map(|parameter| parameter["name"].as_str().unwrap())
            .collect();
        let in_path: BTreeSet<&str> =
            path.split('/').filter_map(|part| part.strip_prefix('{')?.strip_suffix('}')).collect();
        assert_eq!(described, in_path, "{path}");
    }
}

fn each(value: &Value, see: &mut impl FnMut(&Value)) {
    see(value);
    match value {
        Value::Array(list) => list.iter().for_each(|item| each(item, see)),
        Value::Object(map) => map.values().for_each(|item| each(item, see)),
        _ => {}
    }
}

#[test]
fn every_problem_kind_has_an_example() {
    let document = document();
    let examples = document["components"]["examples"].as_object().unwrap();
    assert_eq!(examples.len(), ProblemKind::ALL.len());
    for kind in ProblemKind::ALL {
        let example = &examples[kind.name()]["value"];
        assert_eq!(example["type"], format!("/openapi.json#/components/examples/{}", kind.name()));
        assert_eq!(
            (example["title"].as_str(), example["status"].as_u64()),
            (Some(kind.title()), Some(kind.status().as_u16().into()))
        );
    }
    // An operation refers to a kind only under its status.
    for item in paths(&document).values() {
        for (status, response) in item["get"]["responses"].as_object().unwrap() {
            let examples = &response["content"]["application/problem+json"]["examples"];
            for name in examples.as_object().into_iter().flat_map(Map::keys) {
                let kind = ProblemKind::ALL.into_iter().find(|kind| kind.name() == name).unwrap();
                assert_eq!(*status, kind.status().as_str());
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_documented_status_is_received_and_no_other() {
    let document = document();
    let mut received = BTreeSet::new();
    let usual = Server::start().await;
    let locked = {
        let config =
            ServerConfig { tokens: Some(TokenSet::one("sesame")), threads: 1, ..ServerConfig::default() };
        Server::start_with(config).await
    };
    let overloaded = {
        let config = ServerConfig {
            max_jobs: Some(0),
            threads: 1,
            max_sessions_per_address: Some(0),
            ..ServerConfig::default()
        };
        Server::start_with(config).await
    };
    let guessed = {
        let protected = vec![ProtectedRoute::Metrics, ProtectedRoute::World];
        let tokens = Some(TokenSet::one("sesame"));
        let config = ServerConfig { tokens, protected, threads: 1, ..ServerConfig::default() };
        Server::start_with(config).await
    };
    let other = "0".repeat(64);
    let digest = usual.get("/v1/world").await.json()["digest"].as_str().unwrap().to_owned();
    for template in paths(&document).keys() {
        let path = |digest: &str, level: &str, x: &str| {
            let z = if template.contains("/map/") { "0.png" } else { "0" };
            template
                .replace("{digest}", digest)
                .replace("{level}", level)
                .replace("{x}", x)
                .replace("{z}", z)
                .replace("{name}", "main.js")
        };
        let right = path(&digest, "0", "0");
        let replies = [
            usual.get(&right).await,
            usual.request("GET", &right, &[("If-None-Match", "*")]).await,
            usual.request("GET", &right, &[("If-Match", "\"x\"")]).await,
            usual.get(&path(&other, "0", "0")).await,
            usual.get(&path(&digest, "0", "x")).await,
            usual.get(&right.replace("main.js", "other.js")).await,
            locked.get(&right).await,
            overloaded.get(&right).await,
            guessed.get(&right).await,
            guess(&guessed, &right, &[]).await,
        ];
        let mut statuses: BTreeSet<u16> = replies.iter().map(|reply| reply.status).collect();
        if template == "/v1/stream" {
            statuses.insert(usual.request("GET", &right, &UPGRADE).await.status);
            statuses.insert(usual.request("GET", &right, &UPGRADE[..4]).await.status);
            statuses.insert(overloaded.request("GET", &right, &UPGRADE).await.status);
            statuses.insert(usual.upgrade(&[("Origin", "http://evil.example")]).await.status);
            statuses.insert(locked.upgrade(&[("Authorization", "Bearer wrong")]).await.status);
            statuses.insert(guess(&guessed, &right, &UPGRADE).await.status);
        }
        for status in statuses {
            received.insert((template.clone(), status));
        }
    }

    let documented: BTreeSet<(String, u16)> = paths(&document)
        .iter()
        .flat_map(|(path, item)| {
            let statuses = item["get"]["responses"].as_object().unwrap().keys();
            statuses.map(|status| (path.clone(), status.parse().unwrap()))
        })
        .collect();
    assert_eq!(documented, received);
}
