//! `cluster`: replicas behind nginx without containers, by the configuration that the compose file
//! mounts. With `--check`, what a cluster promises is tried and compared with bars.

mod caching;
mod contents;
mod deploy;
mod failure;
mod http;
mod load;
mod nginx;

use crate::process;
use crate::server::Server;
use anyhow::{Context, Result, bail};
use bars::{Bar, Summary};
use nginx::Nginx;
use std::thread::sleep;
use std::time::Duration;

/// The world of the replicas.
const WORLD_SEED: u64 = 1;

/// Options of the replicas: nginx names its clients. A load has one address for all of its clients.
const OPTIONS: [&str; 4] = ["--trusted-proxy", "127.0.0.1", "--max-sessions-per-address", "1024"];

/// Replicas of a cluster that is checked.
const REPLICAS: u8 = 2;

/// How often a cluster looks for an interrupt and for processes that ended.
const POLL: Duration = Duration::from_millis(200);

/// Options of `cluster`.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct Options {
    /// Servers behind nginx, 2 to 16
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u8).range(2..=16))]
    pub replicas: u8,
    /// Check two replicas instead: caches, a replica killed and one terminated under load; exit 1 if
    /// a bar is missed
    #[arg(long)]
    pub check: bool,
}

/// Servers, and nginx before them. All end when it goes out of scope.
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
    programs.extend(options.check.then_some("tombolo-load"));
    process::run(process::build(&programs)).context("cluster: the build failed")?;
    if options.check {
        let rows = rows().context("cluster")?;
        println!("{}", bars::text(&rows));
        let missed = rows.iter().filter(|row| row.is_missed()).count();
        if Summary::of(&rows).missed > 0 {
            bail!("cluster: {missed} bars missed");
        }
        return Ok(());
    }
    let mut cluster = Cluster::start(options.replicas).context("cluster")?;
    println!("cluster: {} replicas behind http://{}/", options.replicas, cluster.nginx.address());
    for replica in &cluster.replicas {
        println!("  replica http://{}/", replica.address());
    }
    println!("  viewer  tombolo-view --connect ws://{}/v1/stream", cluster.nginx.address());
    println!("cluster: Ctrl-C ends it");
    cluster.wait()
}

/// Every figure of clusters of two replicas beside its bar. Each check has a cluster of its own, whose
/// caches are empty.
///
/// # Errors
/// A process cannot be started or does not answer.
pub fn rows() -> Result<Vec<Bar>> {
    let mut rows = contents::rows()?;
    rows.extend(caching::rows()?);
    rows.extend(failure::rows()?);
    Ok(rows)
}

impl Cluster {
    fn start(replicas: u8) -> Result<Self> {
        let replicas: Vec<Server> =
            (0..replicas).map(|_| Server::start_with(WORLD_SEED, &OPTIONS)).collect::<Result<_>>()?;
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
