use super::*;
use crate::client::PROBE_PERIOD;
use crate::config::Args;
use crate::costs::{Costs, LEVELS};
use clap::Parser;
use load::path::PathKind;
use std::time::Duration;

fn plan(clients: u32, clients_per_replica: u32) -> Plan {
    Plan {
        clients,
        clients_per_replica,
        length: Duration::from_secs(3),
        view_distance_m: 500,
        path: PathKind::Fly,
        seed: 1,
        world_seed: 1,
        processors: 2,
        is_shared: false,
        delay: Duration::from_millis(5),
        link_bytes_per_s: 1e9,
        costs: Costs::default(),
    }
}

fn p50_ms(report: &Report) -> f64 {
    report.latency.quantiles().p50.expect("probes were answered")
}

#[test]
fn the_state_machines_agree_and_every_view_is_served() {
    let report = run(&plan(12, 12));
    assert_eq!((report.wrong, report.refused, report.clients), (0, 0, 12));
    assert!(report.chunks > 12 * 20 && report.made <= report.chunks, "{} chunks", report.chunks);
    assert!(report.views >= 12 * 5 && report.settled >= 12 * 4, "{} settled", report.settled);
    assert!(report.latency.len() > 12 * 5);
    // Two delays of 5 ms lie between a request and its chunk.
    assert!(p50_ms(&report) > 10.0);
}

#[test]
fn the_same_plan_has_the_same_trace_and_another_seed_has_not() {
    let [first, again] = [0, 0].map(|_| run(&plan(8, 4)));
    assert_eq!((first.trace, first.chunks, first.bytes), (again.trace, again.chunks, again.bytes));
    assert_eq!(first.replicas, 2);
    assert_ne!(run(&Plan { seed: 2, ..plan(8, 4) }).trace, first.trace);
}

#[test]
fn costly_work_slow_links_and_shared_processors_take_time() {
    let base = run(&plan(8, 8));
    let costly = Costs { chunk_us: [20_000.0; LEVELS], fast_chunk_us: 20_000.0, ..Costs::default() };
    assert!(p50_ms(&run(&Plan { costs: costly, ..plan(8, 8) })) > p50_ms(&base));
    assert!(p50_ms(&run(&Plan { link_bytes_per_s: 2e5, ..plan(8, 8) })) > p50_ms(&base));
    let shared = run(&Plan { is_shared: true, ..plan(8, 8) });
    assert!(shared.client_s > 0.0 && base.client_s == 0.0);
    assert!(shared.processor_s > base.processor_s);
}

#[test]
fn costs_are_measured_and_read_back() {
    let costs = Costs::default();
    let text = serde_json::to_string(&costs).unwrap();
    assert_eq!(serde_json::from_str::<Costs>(&text).unwrap(), costs);
    assert!(serde_json::from_str::<Costs>(&text.replace("view_us", "veiw_us")).is_err());
}

#[test]
fn a_list_of_costs_without_a_level_is_an_error_that_says_what_to_do() {
    let file = std::env::temp_dir().join(format!("tombolo-costs-{}.json", std::process::id()));
    let plan = |levels: usize| {
        let mut costs = serde_json::json!(Costs::default());
        costs["chunk_us"] = serde_json::json!(vec![0.0; levels]);
        std::fs::write(&file, costs.to_string()).unwrap();
        Args::parse_from(["tombolo-simulate", "--costs", &file.to_string_lossy()]).plan()
    };
    for levels in [1, LEVELS - 1, LEVELS + 1] {
        let error = plan(levels).unwrap_err();
        let cause = format!("chunk_us has {levels} costs in place of {LEVELS}");
        for part in ["--costs", &*file.to_string_lossy(), &cause, "--measure-costs"] {
            assert!(error.contains(part), "{error}");
        }
        assert!(!error.contains('\n'), "{error}");
    }
    // The control: one of each level.
    assert!(plan(LEVELS).unwrap().costs.chunk_us.iter().all(|us| *us == 0.0));
    std::fs::remove_file(file).unwrap();
}

#[test]
fn a_cost_out_of_range_is_an_error_that_names_it() {
    let file = std::env::temp_dir().join(format!("tombolo-cost-{}.json", std::process::id()));
    let plan = |name: &str, us: f64| {
        let mut costs = serde_json::json!(Costs::default());
        match name {
            "chunk_us" => costs[name][LEVELS - 1] = us.into(),
            _ => costs[name] = us.into(),
        }
        std::fs::write(&file, costs.to_string()).unwrap();
        Args::parse_from(["tombolo-simulate", "--costs", &file.to_string_lossy()]).plan()
    };
    for name in serde_json::json!(Costs::default()).as_object().unwrap().keys() {
        for us in [-1.0, 60.1e6, 1e300] {
            let error = plan(name, us).unwrap_err();
            let file = file.to_string_lossy();
            assert!(["--costs", &*file, name].iter().all(|part| error.contains(part)), "{error}");
            assert!(!error.contains('\n'), "{error}");
        }
        // The control: both ends of the range.
        assert!(plan(name, 0.0).is_ok() && plan(name, 60e6).is_ok(), "{name}");
    }
    std::fs::remove_file(file).unwrap();
}

/// A server that does nothing within the run: no probe is answered.
#[test]
fn probes_without_an_answer_count_with_their_waits() {
    let costs = Costs { receive_us: 60e6, ..Costs::default() };
    let report = run(&Plan { costs, ..plan(4, 4) });
    assert_eq!(report.chunks, 0);
    // Those that waited for a second and more are latencies, the latest are not.
    let latest = (Duration::from_secs(1).as_millis() / PROBE_PERIOD.as_millis()) as u64 * 4;
    assert!(!report.latency.is_empty() && report.unanswered > report.latency.len());
    assert!(report.unanswered - report.latency.len() <= latest, "{} unanswered", report.unanswered);
    assert!(report.latency.quantiles().p50 >= Some(1000.0));
    // The control: with a server that answers there are only some at the end.
    assert!(run(&plan(4, 4)).unanswered <= latest);
}

/// Sessions keep the order of their messages where work waits for processors.
#[test]
fn an_overloaded_replica_makes_no_state_machine_reject_a_frame() {
    for is_shared in [false, true] {
        let costs = Costs { receive_us: 4_000.0, write_us: 4_000.0, ..Costs::default() };
        let report = run(&Plan { costs, is_shared, ..plan(40, 40) });
        assert!(report.chunks > 0);
        assert_eq!(report.wrong, 0, "shared: {is_shared}");
        assert!(report.latency.quantiles().max > Some(100.0), "the control: work waits");
    }
}
