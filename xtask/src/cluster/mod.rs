//! `cluster`: replicas behind nginx without containers, by the configuration that the compose file
//! mounts. `--check` measures the guarantees of a cluster and compares the figures with bars.

mod bake;
mod caching;
mod capacity;
mod chunks;
mod contents;
mod deploy;
mod failure;
mod http;
mod load;
mod manifests;
pub mod nginx;
mod objects;
pub mod prometheus;
mod relay;
mod simulation;
mod soak;
mod store;

use crate::process;
use crate::server::Server;
use anyhow::{Context, Result, bail};
use bars::{Bar, Summary};
use nginx::Nginx;
use objects::Objects;
use prometheus::Prometheus;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::thread::sleep;
use std::time::Duration;

/// The world of the replicas.
const WORLD_SEED: u64 = 1;

/// Environment of every replica: nginx is trusted to forward the addresses of its clients.
const TRUST_NGINX: (&str, &str) = ("TOMBOLO_TRUSTED_PROXY", "127.0.0.1");

/// Replicas of a cluster that is checked.
const REPLICAS: u8 = 2;

/// How often a cluster looks for an interrupt and for processes that ended.
const POLL: Duration = Duration::from_millis(200);

/// Options of `cluster`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Servers behind nginx, 2 to 16
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u8).range(2..=16))]
    pub replicas: u8,
    /// Check clusters of two replicas instead, whatever --replicas says: contents, caches, a
    /// replica killed and one terminated under load, a store that fails, a bake in parts, alerts,
    /// cost of a client, the simulation beside real clients; exit 1 if a bar is missed
    #[arg(long)]
    pub check: bool,
    /// With --check: only these
    #[arg(long, value_delimiter = ',', value_enum, requires = "check")]
    pub only: Vec<Check>,
    /// With --only soak: its length in minutes, 2 to 10000
    #[arg(long, value_name = "MIN", requires = "only", default_value_t = soak::LENGTH.as_secs() / 60,
          value_parser = clap::value_parser!(u64).range(2..=10_000))]
    pub soak_minutes: u64,
}

/// A group of measurements that `--check` can run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Check {
    /// One content and one ETag per address.
    Contents,
    /// Many requests for few chunks.
    Caching,
    /// A replica killed and one terminated.
    Failure,
    /// A store that fails.
    Store,
    /// A region baked in parts.
    Bake,
    /// Alerts of Prometheus.
    Alerts,
    /// Processor time, memory and bytes that one client costs the server.
    Capacity,
    /// The simulation beside 1,000 real clients.
    Simulation,
    /// Hours of clients that fly, with a fault every minute; only if it is named.
    Soak,
}

impl Check {
    /// Those that run without `--only`.
    const ALL: [Self; 8] = [
        Self::Contents,
        Self::Caching,
        Self::Failure,
        Self::Store,
        Self::Bake,
        Self::Alerts,
        Self::Capacity,
        Self::Simulation,
    ];

    fn rows(self, soak: Duration) -> Result<Vec<Bar>> {
        match self {
            Self::Contents => contents::rows(),
            Self::Caching => caching::rows(),
            Self::Failure => failure::rows(),
            Self::Store => store::rows(),
            Self::Bake => bake::rows(),
            Self::Alerts => prometheus::rows(),
            Self::Capacity => capacity::rows(),
            Self::Simulation => simulation::rows(),
            Self::Soak => soak::rows(soak),
        }
    }
}

/// Settings of a server in its environment.
type Settings = Vec<(&'static str, String)>;

/// Servers behind nginx. Dropping it ends all processes.
#[derive(Debug)]
struct Cluster {
    /// First, so that it ends before the replicas.
    nginx: Nginx,
    replicas: Vec<Server>,
}

/// Builds and starts a cluster; waits for Ctrl-C, or checks it.
///
/// # Errors
/// nginx is missing, a build or a process failed, or a bar is missed.
pub fn run(options: Options) -> Result<()> {
    let mut programs = vec!["tombolo-server"];
    if options.check {
        programs.extend(["tombolo-load", "tombolo-simulate"]);
    }
    process::run(process::build(&programs)).context("cluster: the build failed")?;
    if options.check {
        let checks = if options.only.is_empty() { Check::ALL.to_vec() } else { options.only };
        let soak = Duration::from_secs(60 * options.soak_minutes);
        let rows = run_checks(&checks, soak).context("cluster")?;
        println!("{}", bars::text(&rows));
        let missed = Summary::of(&rows).missed;
        if missed > 0 {
            bail!("cluster: {missed} bars missed");
        }
        return Ok(());
    }
    let (objects, settings) = shared_store().context("cluster")?;
    let mut cluster = Cluster::start_with(options.replicas, &settings).context("cluster")?;
    println!("cluster: {} replicas behind http://{}/", options.replicas, cluster.nginx.address());
    let prometheus = start_prometheus(&cluster).context("cluster")?;
    for replica in &cluster.replicas {
        println!("  replica http://{}/", replica.address());
    }
    println!("  viewer  tombolo-view --connect ws://{}/v1/stream", cluster.nginx.address());
    println!("cluster: Ctrl-C ends it");
    let ended = cluster.wait();
    drop((cluster, prometheus, objects));
    ended
}

/// A store for all replicas, with the settings that name it: S3 on the loopback, or a folder.
fn shared_store() -> Result<(Option<Objects>, Settings)> {
    if let Some(why) = objects::lacks() {
        let folder = folder("store")?;
        println!("cluster: the store is the folder {}; S3 {why}", folder.display());
        return Ok((None, vec![("TOMBOLO_STORE", folder.display().to_string())]));
    }
    let objects = Objects::start("store", None)?;
    let settings = objects.settings().to_vec();
    println!("cluster: the store is {} at {}", settings[0].1, settings[1].1);
    Ok((Some(objects), settings))
}

/// Prometheus over the replicas and nginx, where it is installed.
fn start_prometheus(cluster: &Cluster) -> Result<Option<Prometheus>> {
    if let Some(why) = prometheus::lacks() {
        println!("cluster: no alerts are evaluated; Prometheus {why}");
        return Ok(None);
    }
    let addresses: Vec<_> = cluster.replicas.iter().map(Server::address).collect();
    let prometheus = Prometheus::start(&addresses, cluster.nginx.metrics())?;
    println!("  alerts  http://{}/alerts", prometheus.address());
    Ok(Some(prometheus))
}

/// Every figure of clusters of two replicas beside its bar. Each check starts a cluster with empty
/// caches. A failed check is a missed row.
///
/// # Errors
/// An interrupt.
pub fn rows() -> Result<Vec<Bar>> {
    run_checks(&Check::ALL, soak::LENGTH)
}

/// The rows of [`Check::Soak`], of its whole length.
///
/// # Errors
/// An interrupt.
pub fn soak_rows() -> Result<Vec<Bar>> {
    run_checks(&[Check::Soak], soak::LENGTH)
}

fn run_checks(checks: &[Check], soak: Duration) -> Result<Vec<Bar>> {
    let mut rows = Vec::new();
    for check in checks {
        if process::interrupted() {
            bail!("interrupted");
        }
        match check.rows(soak) {
            Ok(more) => rows.extend(more),
            Err(error) if process::interrupted() => return Err(error.context(format!("{check:?}"))),
            // A failed check does not discard the results of the others.
            Err(error) => {
                eprintln!("cluster: {check:?}: {error:#}");
                let name = format!("{check:?}: whether it could be measured");
                rows.push(Bar::some(name, None).with_note(format!("{error:#}")));
            }
        }
    }
    Ok(rows)
}

/// An empty folder among the results of the build, for the files of a process.
fn folder(name: &str) -> Result<PathBuf> {
    let folder = process::target().join("cluster").join(format!("{}-{name}", std::process::id()));
    // A failed check leaves it behind.
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    Ok(folder)
}

/// A replica at an address that another one had.
fn replica_at(address: SocketAddr, settings: &[(&str, String)]) -> Result<Server> {
    Server::start_at(address, WORLD_SEED, &replica_environment(settings))
}

/// Environment of a replica: that of every replica, and `settings`.
fn replica_environment<'a>(settings: &[(&'a str, String)]) -> Vec<(&'a str, String)> {
    [&[(TRUST_NGINX.0, TRUST_NGINX.1.to_owned())], settings].concat()
}

impl Cluster {
    fn start(replicas: u8) -> Result<Self> {
        Self::start_with(replicas, &[])
    }

    /// With settings in the environment of the replicas.
    fn start_with(replicas: u8, settings: &[(&str, String)]) -> Result<Self> {
        let settings = replica_environment(settings);
        let replicas: Vec<Server> =
            (0..replicas).map(|_| Server::start_with(WORLD_SEED, &settings)).collect::<Result<_>>()?;
        let addresses: Vec<_> = replicas.iter().map(Server::address).collect();
        Ok(Self { nginx: Nginx::start(&addresses)?, replicas })
    }

    /// Until an interrupt. A replica that ends is reported once; the others go on.
    fn wait(&mut self) -> Result<()> {
        let mut running = self.replicas.len();
        while !process::interrupted() {
            if !self.nginx.is_running() {
                bail!("cluster: nginx ended; its message is above");
            }
            let now =
                self.replicas.iter_mut().filter_map(|replica| replica.is_running().then_some(())).count();
            if now < running {
                println!("cluster: {now} of {} replicas are left", self.replicas.len());
                running = now;
            }
            sleep(POLL);
        }
        Ok(())
    }
}
