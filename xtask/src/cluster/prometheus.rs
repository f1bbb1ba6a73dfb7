//! Prometheus with the rules of `deploy/prometheus`: its configuration with the addresses of this
//! machine, the rules as they are.

use super::http::get;
use crate::process;
use crate::server::Server;
use anyhow::{Context, Result, bail, ensure};
use bars::Bar;
use bars::figures::{list, text};
use serde_json::Value;
use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// The configuration that the compose file mounts.
const CONFIGURATION: &str = include_str!("../../../deploy/prometheus/prometheus.yml");

/// The addresses in it.
const TARGETS: &str = "targets: [\"replica-1:7580\", \"replica-2:7580\"]";

/// The address of nginx in it.
const NGINX: &str = "targets: [\"nginx:7581\"]";

/// The rules, from the root of the repository.
const RULES: &str = "deploy/prometheus/alerts.yml";

/// Time until it must answer.
const READY_WITHIN: Duration = Duration::from_secs(20);

/// Time for its end.
const END_WITHIN: Duration = Duration::from_secs(5);

/// Time after which an alert of replicas that run would fire, longer than `for` of ReplicaDown.
const QUIET_FOR: Duration = Duration::from_secs(40);

/// Time in which a killed replica must be an alert: scrapes of 5 s, a rule of 30 s.
const ALERT_WITHIN: Duration = Duration::from_secs(60);

/// A running Prometheus with a folder of its own; both end with it.
#[derive(Debug)]
pub struct Prometheus {
    child: Child,
    address: SocketAddr,
    folder: PathBuf,
}

/// An alert, pending or firing.
#[derive(Debug)]
struct Alert {
    name: String,
    /// The replica, as `HOST:PORT`.
    instance: String,
    is_firing: bool,
}

/// Why there is none on this machine; none if there is.
pub fn lacks() -> Option<String> {
    let mut version = process::command("prometheus");
    version.arg("--version");
    (!process::succeeds(version)).then(|| "needs Prometheus: apt-get install prometheus".into())
}

impl Prometheus {
    /// Starts it on a free port of the loopback, with these replicas and the metrics of nginx as
    /// targets.
    ///
    /// # Errors
    /// It is not installed, rejects its configuration, or does not answer in time.
    pub fn start(replicas: &[SocketAddr], nginx: SocketAddr) -> Result<Self> {
        let folder = super::folder("prometheus")?;
        std::fs::write(folder.join("prometheus.yml"), configuration(replicas, nginx)?)?;
        let address = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
        let child = process::command("prometheus")
            .arg(format!("--config.file={}", folder.join("prometheus.yml").display()))
            .arg(format!("--storage.tsdb.path={}", folder.join("data").display()))
            .arg(format!("--web.listen-address={address}"))
            .arg("--log.level=error")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .context("cannot start prometheus")?;
        let mut prometheus = Self { child, address, folder };
        let deadline = Instant::now() + READY_WITHIN;
        while get(address, "/-/ready").is_err() {
            if !matches!(prometheus.child.try_wait(), Ok(None)) || Instant::now() > deadline {
                bail!("prometheus does not answer at {address}; its message is above");
            }
            sleep(Duration::from_millis(50));
        }
        Ok(prometheus)
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Names of the rules that it has read.
    fn rules(&self) -> Result<Vec<String>> {
        let answer = self.ask("rules")?;
        let rules = list(&answer, "data/groups").iter().flat_map(|group| list(group, "rules"));
        Ok(rules.filter_map(|rule| text(rule, "name")).map(String::from).collect())
    }

    /// Alerts that fire or are about to.
    fn alerts(&self) -> Result<Vec<Alert>> {
        let answer = self.ask("alerts")?;
        let alert = |alert: &Value| Alert {
            name: text(alert, "labels/alertname").unwrap_or_default().to_owned(),
            instance: text(alert, "labels/instance").unwrap_or_default().to_owned(),
            is_firing: text(alert, "state") == Some("firing"),
        };
        Ok(list(&answer, "data/alerts").iter().map(alert).collect())
    }

    /// Replicas and nginx, as far as they answered its last request.
    fn up(&self) -> Result<usize> {
        let answer = self.ask("targets?state=active")?;
        let targets = list(&answer, "data/activeTargets").iter();
        Ok(targets.filter(|target| text(target, "health") == Some("up")).count())
    }

    fn ask(&self, what: &str) -> Result<Value> {
        let answer = get(self.address, &format!("/api/v1/{what}"))?;
        serde_json::from_slice(&answer.body).context("Prometheus does not answer in JSON")
    }
}

impl Drop for Prometheus {
    fn drop(&mut self) {
        process::stop(&mut self.child, END_WITHIN);
        // Results of a build may stay: a failed removal is harmless.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// The configuration with these addresses, and the rules where they are.
fn configuration(replicas: &[SocketAddr], nginx: SocketAddr) -> Result<String> {
    for targets in [TARGETS, NGINX] {
        ensure!(CONFIGURATION.contains(targets), "prometheus.yml has other targets than: {targets}");
    }
    let targets = replicas.iter().map(|address| format!("\"{address}\"")).collect::<Vec<_>>().join(", ");
    let rules = process::root().join(RULES);
    Ok(CONFIGURATION
        .replace(TARGETS, &format!("targets: [{targets}]"))
        .replace(NGINX, &format!("targets: [\"{nginx}\"]"))
        .replace("[alerts.yml]", &format!("[\"{}\"]", rules.display())))
}

/// The rows: a replica that is killed becomes an alert, and nothing was one before.
///
/// # Errors
/// A process does not start or does not answer.
pub fn rows() -> Result<Vec<Bar>> {
    const ALERT: &str = "Prometheus: seconds from SIGKILL of a replica to the alert ReplicaDown";
    if let Some(reason) = lacks() {
        return Ok(vec![Bar::reported(ALERT, None, "s").not_measured_if(true, &reason)]);
    }
    let mut cluster = super::Cluster::start(super::REPLICAS)?;
    let addresses: Vec<_> = cluster.replicas.iter().map(Server::address).collect();
    let prometheus = Prometheus::start(&addresses, cluster.nginx.metrics())?;
    let deadline = Instant::now() + READY_WITHIN;
    while prometheus.up()? < addresses.len() + 1 && Instant::now() < deadline {
        sleep(Duration::from_millis(200));
    }
    let up = prometheus.up()?;
    // So long that a rule that takes a healthy replica for a dead one fires.
    sleep(QUIET_FOR);
    let before = prometheus.alerts()?;
    let killed = Instant::now();
    let mut victim = cluster.replicas.remove(0);
    victim.kill();
    let name = victim.address().to_string();
    let is_down = |alert: &Alert| alert.is_firing && alert.name == "ReplicaDown";
    let took = loop {
        let down: Vec<_> = prometheus.alerts()?.into_iter().filter(is_down).collect();
        if let [alert] = &down[..]
            && alert.instance == name
        {
            break Some(killed.elapsed().as_secs_f64());
        }
        if killed.elapsed() > ALERT_WITHIN {
            break None;
        }
        sleep(Duration::from_millis(200));
    };
    let rules = prometheus.rules()?;
    let written = include_str!("../../../deploy/prometheus/alerts.yml").matches("- alert:").count();
    Ok(vec![
        Bar::none("Prometheus: rules that it has not read", Some(written.abs_diff(rules.len()) as f64)),
        Bar::at_least("Prometheus: replicas and nginx that it reaches, of 3", Some(up as f64), "", 3.0),
        Bar::none(
            "control: alerts, pending or firing, before a replica is killed",
            Some(before.len() as f64),
        ),
        Bar::at_most(ALERT, took, "s", ALERT_WITHIN.as_secs_f64()),
    ])
}

/// Whether `promtool` accepts the rules and the configuration and finds the alerts that their tests
/// expect, and rejects a rule with a syntax error and one that never fires.
///
/// # Errors
/// It rejects them, or accepts what is wrong.
pub fn check() -> Result<()> {
    let promtool = |what: [&str; 2], file: &Path| {
        let mut command = Command::new("promtool");
        command.args(what).arg(file);
        command
    };
    let given = |name: &str| process::root().join("deploy/prometheus").join(name);
    for (what, name) in [
        (["check", "rules"], "alerts.yml"),
        (["check", "config"], "prometheus.yml"),
        (["test", "rules"], "alerts.test.yml"),
    ] {
        process::run(promtool(what, &given(name))).with_context(|| format!("promtool rejects {name}"))?;
    }
    let folder = super::folder("promtool")?;
    let (rules, tests) = (folder.join("alerts.yml"), folder.join("alerts.test.yml"));
    std::fs::copy(given("alerts.test.yml"), &tests)?;
    for (what, file, from, to) in [
        (["check", "rules"], &rules, "== 0", "== )"),
        (["test", "rules"], &tests, "up{job=\"tombolo\"} == 0", "up{job=\"tombolo\"} == 2"),
    ] {
        let text = std::fs::read_to_string(given("alerts.yml"))?;
        ensure!(text.contains(from), "the control: the rules have no `{from}`");
        std::fs::write(&rules, text.replacen(from, to, 1))?;
        let is_accepted = process::succeeds(promtool(what, file));
        ensure!(!is_accepted, "the control: promtool accepts `{to}` in place of `{from}`");
    }
    // Results of a build may stay: a failed removal is harmless.
    let _ = std::fs::remove_dir_all(&folder);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_configuration_has_the_replicas_of_this_machine_and_the_rules_of_the_container() {
        let [replica, nginx] = ["127.0.0.1:7001", "127.0.0.1:7002"].map(|text| text.parse().unwrap());
        let text = configuration(&[replica], nginx).unwrap();
        for address in [replica, nginx] {
            assert!(text.contains(&format!("targets: [\"{address}\"]")), "{text}");
        }
        assert!(!text.contains("replica-1") && !text.contains("nginx:"), "{text}");
        let rules = text.lines().find_map(|line| line.strip_prefix("rule_files: [\"")?.strip_suffix("\"]"));
        assert!(Path::new(rules.unwrap()).is_file(), "{text}");
    }
}
