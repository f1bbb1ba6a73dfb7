//! A replica that ends under load: killed, as by a power cut, and terminated, as by an operator.

use super::Cluster;
use super::http::metric;
use super::load::Load;
use crate::process;
use anyhow::{Result, ensure};
use bars::Bar;
use bars::figures::{at, list};
use serde_json::Value;
use std::thread::sleep;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Clients of a load whose replica is killed.
const KILLED_CLIENTS: u32 = 200;

/// Clients of a load whose replica is terminated.
const TERMINATED_CLIENTS: u32 = 500;

/// A load runs so long, seconds; a replica ends after a third of it.
const LOAD_S: u64 = 24;

/// Open sessions of a replica.
const SESSIONS: &str = "tombolo_sessions";

/// The rows of both ends.
///
/// # Errors
/// A process does not start, or what was to be tried did not happen.
pub fn rows() -> Result<Vec<Bar>> {
    let (mut rows, again) = killed(&[])?;
    let (_, control) = killed(&["--no-resume"])?;
    rows.extend([
        Bar::at_most("killed: bytes sent again of those that clients held", again, "%", 5.0),
        Bar::at_least("control: the same where clients do not report what they hold", control, "%", 20.0),
    ]);
    rows.extend(terminated()?);
    Ok(rows)
}

/// SIGKILL, with a store that the replicas share: the rows, and the share of held bytes that came
/// again, percent.
fn killed(more: &[&str]) -> Result<(Vec<Bar>, Option<f64>)> {
    let (objects, mut settings) = super::shared_store()?;
    settings.push(super::store::compose_wait());
    let mut cluster = Cluster::start_with(super::REPLICAS, &settings)?;
    let load = Load::start(cluster.nginx.address(), KILLED_CLIENTS, LOAD_S, more)?;
    sleep(Duration::from_secs(LOAD_S / 3));
    let mut victim = cluster.replicas.remove(0);
    let lost = metric(victim.address(), SESSIONS)?;
    victim.kill();
    sleep(Duration::from_secs(LOAD_S / 3));
    let after = cluster.replicas.iter().map(|replica| metric(replica.address(), SESSIONS));
    let after = after.sum::<Result<f64>>()?;
    let report = load.report()?;
    ensure!(lost > 0.0, "the replica to be killed had no session: nothing was tried");
    let seconds = list(&report, "timeline").iter().skip(1);
    ensure!(seconds.len() + 2 >= LOAD_S as usize, "tombolo-load ended early");
    let empty = seconds.filter(|second| at(second, "chunks").is_none_or(|chunks| chunks == 0.0)).count();
    let again = ratio(&report, "resume/bytes_again", "resume/held_bytes").map(|share| 100.0 * share);
    let store = if objects.is_some() { "an S3 store" } else { "a folder as their store" };
    let rows = vec![
        Bar::reported("killed: sessions of the replica, of 200", Some(lost), "")
            .with_note(format!("the replicas share {store}, with the settings of docker-compose.yml")),
        wrong("killed: wrong chunks", &report),
        Bar::none("killed: lost sessions without another", without_another(&report)),
        Bar::at_least(
            "killed: clients with a session 8 s later",
            Some(after / f64::from(KILLED_CLIENTS)),
            "",
            1.0,
        ),
        Bar::at_least(
            "killed: lost sessions that another replaced",
            at(&report, "resume/resumed").map(|resumed| resumed / lost),
            "",
            1.0,
        ),
        Bar::under("killed: gap between deliveries, p99", gap(&report, "p99"), "s", 2.0),
        Bar::none("killed: seconds without a chunk for anybody", Some(empty as f64)),
    ];
    Ok((rows, again))
}

/// SIGTERM.
fn terminated() -> Result<Vec<Bar>> {
    let mut cluster = Cluster::start(super::REPLICAS)?;
    let load = Load::start(cluster.nginx.address(), TERMINATED_CLIENTS, LOAD_S, &[])?;
    sleep(Duration::from_secs(LOAD_S / 3));
    let mut victim = cluster.replicas.remove(0);
    let sessions = metric(victim.address(), SESSIONS)?;
    let at_s = SystemTime::now().duration_since(UNIX_EPOCH)?.as_secs_f64();
    let took = victim.terminate();
    let report = load.report()?;
    ensure!(sessions > 0.0, "the replica to be terminated had no session: nothing was tried");
    ensure!(!process::interrupted(), "interrupted");
    let share = |path: &str| at(&report, path).map(|number| number / sessions);
    // 0 is no Close frame at all.
    let closed_s = at(&report, "resume/last_close_s").filter(|close| *close > 0.0);
    let last = at(&report, "started_unix_s").zip(closed_s).map(|(start, close)| start + close - at_s);
    Ok(vec![
        Bar::reported("terminated: sessions of the replica, of 500", Some(sessions), ""),
        Bar::at_least(
            "terminated: sessions with a Close frame",
            share("resume/closed_as_announced"),
            "",
            1.0,
        ),
        Bar::at_most(
            "terminated: from SIGTERM to the last Close frame",
            last.filter(|seconds| *seconds >= 0.0),
            "s",
            1.0,
        ),
        Bar::at_most(
            "terminated: from SIGTERM to the end of the process",
            took.map(|took| took.as_secs_f64()),
            "s",
            10.0,
        ),
        wrong("terminated: wrong or cut chunks", &report),
        Bar::none("terminated: lost sessions without another", without_another(&report)),
        Bar::at_least("terminated: lost sessions that another replaced", share("resume/resumed"), "", 1.0),
        Bar::at_most("terminated: gap between deliveries, longest", gap(&report, "max"), "s", 5.0),
    ])
}

/// Chunks that differ from those of local generation, and frames that a client rejected.
pub fn wrong(name: &str, report: &Value) -> Bar {
    let compared = at(report, "regenerated").filter(|compared| *compared > 0.0);
    let note = format!("{} chunks, one of 32, were generated again and compared", compared.unwrap_or(0.0));
    Bar::none(name, compared.and(at(report, "mismatches"))).with_note(note)
}

/// Sessions of the whole run that were lost and not replaced.
pub fn without_another(report: &Value) -> Option<f64> {
    Some(at(report, "resume/lost")? - at(report, "resume/resumed")?)
}

/// A quantile of the gaps, seconds.
pub fn gap(report: &Value, quantile: &str) -> Option<f64> {
    at(report, &format!("resume/gap_ms/{quantile}")).map(|ms| ms / 1000.0)
}

fn ratio(report: &Value, part: &str, whole: &str) -> Option<f64> {
    at(report, whole).filter(|whole| *whole > 0.0).and_then(|whole| Some(at(report, part)? / whole))
}
