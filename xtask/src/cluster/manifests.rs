//! The compose file and the Kubernetes manifests, read by the types of their specifications.
//!
//! Types ignore fields that they do not know, so each document is written again and compared: what
//! was lost is a misspelt or misplaced field.

#![cfg(test)]

use docker_compose_types::{Compose, DependsOnOptions};
use k8s_openapi::api::apps::v1::Deployment;
use k8s_openapi::api::autoscaling::v2::HorizontalPodAutoscaler;
use k8s_openapi::api::batch::v1::Job;
use k8s_openapi::api::core::v1::Service;
use k8s_openapi::api::policy::v1::PodDisruptionBudget;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

const COMPOSE: &str = include_str!("../../../docker-compose.yml");

const MANIFESTS: [(&str, &str); 2] = [
    ("server.yaml", include_str!("../../../deploy/kubernetes/server.yaml")),
    ("bake.yaml", include_str!("../../../deploy/kubernetes/bake.yaml")),
];

/// Fields of services that the specification has and the types lack.
const UNTYPED: [&str; 1] = ["pids_limit"];

/// A document as a type reads it, and the paths of lost fields.
fn typed<T: DeserializeOwned + Serialize>(source: &Value) -> Result<(T, Vec<String>), String> {
    let document: T = serde_json::from_value(source.clone()).map_err(|error| error.to_string())?;
    let written = serde_json::to_value(&document).map_err(|error| error.to_string())?;
    let mut lost = Vec::new();
    compare(source, &written, "", &mut lost);
    Ok((document, lost))
}

fn compare(source: &Value, written: &Value, path: &str, lost: &mut Vec<String>) {
    match (source, written) {
        (Value::Object(source), Value::Object(written)) => {
            for (name, value) in source {
                let path = format!("{path}/{name}");
                match written.get(name) {
                    // A field without a value.
                    _ if value.is_null() => {}
                    Some(written) => compare(value, written, &path, lost),
                    None => lost.push(path),
                }
            }
        }
        (Value::Array(source), Value::Array(written)) if source.len() == written.len() => {
            for (index, (source, written)) in source.iter().zip(written).enumerate() {
                compare(source, written, &format!("{path}/{index}"), lost);
            }
        }
        (source, written) if source == written => {}
        _ => lost.push(path.to_owned()),
    }
}

/// Checks one Kubernetes object; what is wrong with it.
fn problem(object: &Value) -> Option<String> {
    let lost = match (object["apiVersion"].as_str()?, object["kind"].as_str()?) {
        ("apps/v1", "Deployment") => typed::<Deployment>(object).map(|typed| typed.1),
        ("v1", "Service") => typed::<Service>(object).map(|typed| typed.1),
        ("policy/v1", "PodDisruptionBudget") => typed::<PodDisruptionBudget>(object).map(|typed| typed.1),
        ("autoscaling/v2", "HorizontalPodAutoscaler") => {
            typed::<HorizontalPodAutoscaler>(object).map(|typed| typed.1)
        }
        ("batch/v1", "Job") => typed::<Job>(object).map(|typed| typed.1),
        (version, kind) => Err(format!("{version} {kind} is not checked")),
    };
    match lost {
        Ok(lost) if lost.is_empty() => None,
        Ok(lost) => Some(format!("unknown: {}", lost.join(", "))),
        Err(error) => Some(error),
    }
}

/// The objects of a manifest.
fn objects(text: &str) -> Vec<Value> {
    let documents = serde_norway::Deserializer::from_str(text);
    documents.map(|document| serde::Deserialize::deserialize(document).expect("YAML")).collect()
}

#[test]
fn manifests_have_the_fields_of_the_kubernetes_api() {
    for (file, text) in MANIFESTS {
        let objects = objects(text);
        assert!(!objects.is_empty(), "{file}");
        for object in &objects {
            assert_eq!(problem(object), None, "{file}: {}", object["kind"]);
        }
    }
}

/// The controls: a misspelt field, one in another place, one of another type, a kind without a
/// check.
#[test]
fn damaged_manifests_are_found() {
    for (from, to, found) in [
        ("readinessProbe:", "readynessProbe:", "/spec/template/spec/containers/0/readynessProbe"),
        ("terminationGracePeriodSeconds: 35", "minReadySeconds: 35", "/spec/template/spec/minReadySeconds"),
        ("sleep: { seconds: 5 }", "wait: { seconds: 5 }", "/lifecycle/preStop/wait"),
        ("policies:", "policy:", "/spec/behavior/scaleDown/policy"),
        ("containerPort: 7580", "containerPort: many", "invalid type"),
        ("kind: Deployment", "kind: Deploymint", "is not checked"),
    ] {
        let text = MANIFESTS[0].1.replace(from, to);
        assert_ne!(text, MANIFESTS[0].1, "{from}");
        let problems: Vec<_> = objects(&text).iter().filter_map(problem).collect();
        assert!(problems.len() == 1 && problems[0].contains(found), "{to}: {problems:?}");
    }
}

/// What one manifest names in another, and what the server states elsewhere.
#[test]
fn manifests_fit_each_other_and_the_server() {
    let all: Vec<_> = MANIFESTS.iter().flat_map(|(_, text)| objects(text)).collect();
    let of = |kind: &str| all.iter().find(|object| object["kind"] == kind).unwrap_or(&Value::Null);
    let (deployment, service) = (of("Deployment"), of("Service"));
    let labels = &deployment["spec"]["template"]["metadata"]["labels"];
    assert_eq!(&deployment["spec"]["selector"]["matchLabels"], labels);
    assert_eq!(&service["spec"]["selector"], labels);
    assert_eq!(&of("PodDisruptionBudget")["spec"]["selector"]["matchLabels"], labels);
    let autoscaler = &of("HorizontalPodAutoscaler")["spec"];
    assert_eq!(autoscaler["scaleTargetRef"]["name"], deployment["metadata"]["name"]);
    let pods = autoscaler["metrics"].as_array().unwrap().iter().map(|metric| &metric["pods"]);
    let names: Vec<_> = pods.map(|pods| pods["metric"]["name"].as_str().unwrap()).collect();
    // Work and places: either can run out first.
    assert_eq!(names, ["tombolo_generation_pending_jobs", "tombolo_sessions"]);
    let table = include_str!("../../../docs/operations.md");
    for name in names {
        assert!(table.contains(&format!("| `{name}` |")), "{name}");
    }
    // The pause before SIGTERM is a part of the time to the end; the compose file has the rest.
    let pod = &deployment["spec"]["template"]["spec"];
    let pause = pod["containers"][0]["lifecycle"]["preStop"]["sleep"]["seconds"].as_i64().unwrap();
    assert!(pod["terminationGracePeriodSeconds"].as_i64() >= Some(pause + 25));
    // Server and bake are one image, which a node may have without a registry.
    for object in [deployment, of("Job")] {
        let container = &object["spec"]["template"]["spec"]["containers"][0];
        assert_eq!(container["image"], pod["containers"][0]["image"]);
        assert_eq!(container["imagePullPolicy"], "IfNotPresent");
    }
    // Server and bake must name one world and one store.
    let settings = |object: &Value| object["spec"]["template"]["spec"]["containers"][0]["env"].clone();
    let named = |settings: &Value, name: &str| {
        settings.as_array().unwrap().iter().find(|setting| setting["name"] == name).cloned()
    };
    for name in ["TOMBOLO_WORLD_SEED", "TOMBOLO_STORE"] {
        let one = named(&settings(deployment), name);
        assert!(one.is_some() && one == named(&settings(of("Job")), name), "{name}");
    }
    let job = &of("Job")["spec"];
    let parts = format!("--part=$(JOB_COMPLETION_INDEX)/{}", job["completions"]);
    let arguments = job["template"]["spec"]["containers"][0]["args"].as_array().unwrap();
    assert!(arguments.contains(&Value::from(parts.as_str())), "{parts}");
}

/// A compose file by its types; what is wrong with it.
fn compose(text: &str) -> Result<Compose, String> {
    let mut source: Value = serde_norway::from_str(text).map_err(|error| error.to_string())?;
    for service in source["services"].as_object_mut().into_iter().flat_map(|services| services.values_mut()) {
        UNTYPED.iter().for_each(|field| _ = service.as_object_mut().map(|fields| fields.remove(*field)));
    }
    let (compose, lost) = typed::<Compose>(&source)?;
    if lost.is_empty() { Ok(compose) } else { Err(format!("unknown: {}", lost.join(", "))) }
}

#[test]
fn the_compose_file_has_the_fields_of_the_specification() {
    let compose = compose(COMPOSE).unwrap();
    let services = &compose.services.0;
    assert!(services.len() >= 5, "{:?}", services.keys());
    for (name, service) in services {
        let service = service.as_ref().unwrap();
        if let DependsOnOptions::Conditional(others) = &service.depends_on {
            assert!(others.keys().all(|other| services.contains_key(other)), "{name}: {others:?}");
        }
        // One or the other: two services that build one image name export it at the same time.
        assert!(service.image.is_some() != service.build_.is_some(), "{name}");
        assert!(service.mem_limit.is_some() && service.logging.is_some(), "{name}");
    }
    let nginx = services["nginx"].as_ref().unwrap();
    // It looks up the addresses of the replicas while it runs: it starts without them, and its
    // sessions outlive a replica.
    let DependsOnOptions::Conditional(others) = &nginx.depends_on else { panic!("{:?}", nginx.depends_on) };
    let is_free = |other: &docker_compose_types::DependsCondition| {
        other.restart.is_none() && other.condition == "service_started"
    };
    assert!(others.len() == 2 && others.values().all(is_free), "{others:?}");
    let replica = services["replica-1"].as_ref().unwrap();
    assert!(replica.read_only && replica.cap_drop == ["ALL"]);
    // More than the drain (5 s), pending reads and tiles (1 s), the last writes (2 s) and the last
    // traces (5 s).
    assert_eq!(replica.stop_grace_period.as_deref(), Some("25s"));
}

/// The controls.
#[test]
fn damaged_compose_files_are_found() {
    for (from, to, found) in [
        ("  replica-2: *replica", "  replica-2: *replicas", "unknown anchor"),
        ("    read_only: true", "    read_onyl: true", "read_onyl"),
        ("depends_on:", "depend_on:", "depend_on"),
        ("max-size: 50m", "max-size: [50m]", "did not match"),
        ("stop_grace_period: 25s", "stop_grace_period: [25s]", "invalid type"),
    ] {
        let text = COMPOSE.replace(from, to);
        assert_ne!(text, COMPOSE, "{from}");
        let problem = compose(&text).map(drop).unwrap_err();
        assert!(problem.contains(found), "{to}: {problem}");
    }
}
