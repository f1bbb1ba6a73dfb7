use super::*;
use crate::costs::Costs;
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
    let costly = Costs { chunk_us: vec![20_000.0; 17], fast_chunk_us: 20_000.0, ..Costs::default() };
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
