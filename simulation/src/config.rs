//! Options, checked once.

use crate::costs::Costs;
use clap::Parser;
use load::path::PathKind;
use std::path::PathBuf;
use std::time::Duration;

/// Simulates many clients of a cluster in virtual time, with the measured costs of the server's
/// work.
///
/// Clients fly as those of tombolo-load with the same options, and the same options give the same
/// report.
#[derive(Clone, Debug, Parser)]
#[command(name = "tombolo-simulate", version)]
pub struct Args {
    /// Number of clients, 1 to 100000000
    #[arg(long, value_name = "N", default_value_t = 1000,
          value_parser = clap::value_parser!(u32).range(1..=100_000_000))]
    pub clients: u32,
    /// Clients of each replica, 1 to 100000; the last may have fewer
    #[arg(long, value_name = "N", default_value_t = 1000,
          value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub clients_per_replica: u32,
    /// Length in virtual seconds, 1 to 86400
    #[arg(long, value_name = "S", default_value_t = 10,
          value_parser = clap::value_parser!(u64).range(1..=86_400))]
    pub seconds: u64,
    /// View distance of every client in metres, 1 to 65536
    #[arg(long, value_name = "M", default_value_t = 2000,
          value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub view_distance: u32,
    /// How clients move
    #[arg(long, value_name = "PATH", value_enum, default_value_t = PathKind::Fly)]
    pub path: PathKind,
    /// Seed of the paths
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u32,
    /// Seed of the world
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub world_seed: u64,
    /// Processors of a replica, 1 to 1024
    #[arg(long, value_name = "N", default_value_t = 2,
          value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub processors: u16,
    /// Clients run on the processors of their replica, as in a test on one machine
    #[arg(long)]
    pub shared: bool,
    /// One-way delay of the network in microseconds, 0 to 10000000
    #[arg(long, value_name = "US", default_value_t = 50,
          value_parser = clap::value_parser!(u64).range(0..=10_000_000))]
    pub delay_us: u64,
    /// Link of each client in Mbit/s, 1 to 100000
    #[arg(long, value_name = "MBIT", default_value_t = 100_000,
          value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub link_mbit: u32,
    /// File with the costs as JSON, as --measure-costs prints them [default: built in]
    #[arg(long, value_name = "FILE")]
    pub costs: Option<PathBuf>,
    /// Measure the costs on this machine, print them as JSON and end
    #[arg(long)]
    pub measure_costs: bool,
    /// File for the report as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Parameters of a simulation. All values are in range.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Clients of all replicas.
    pub clients: u32,
    /// Clients of each replica; the last may have fewer.
    pub clients_per_replica: u32,
    /// Length.
    pub length: Duration,
    /// View distance, metres.
    pub view_distance_m: u32,
    /// How clients move.
    pub path: PathKind,
    /// Seed of the paths.
    pub seed: u32,
    /// Seed of the world.
    pub world_seed: u64,
    /// Processors of a replica.
    pub processors: usize,
    /// Whether clients run on them too.
    pub is_shared: bool,
    /// One-way delay of the network.
    pub delay: Duration,
    /// Link of each client, bytes a second.
    pub link_bytes_per_s: f64,
    /// Times of the work.
    pub costs: Costs,
}

impl Plan {
    /// Number of replicas.
    #[must_use]
    pub const fn replicas(&self) -> u32 {
        self.clients.div_ceil(self.clients_per_replica)
    }
}

impl Args {
    /// Reads the costs.
    ///
    /// # Errors
    /// One line: the file cannot be read, is not JSON of `--measure-costs`, or has a cost out of
    /// range.
    pub fn plan(&self) -> Result<Plan, String> {
        let costs = match &self.costs {
            None => Costs::default(),
            Some(file) => {
                let text = std::fs::read_to_string(file)
                    .map_err(|error| format!("--costs: cannot read {}: {error}", file.display()))?;
                let costs: Costs = serde_json::from_str(&text).map_err(|error| {
                    format!("--costs: {} is not valid JSON of --measure-costs: {error}", file.display())
                })?;
                costs.check().map_err(|error| format!("--costs: {}: {error}", file.display()))?;
                costs
            }
        };
        Ok(Plan {
            clients: self.clients,
            clients_per_replica: self.clients_per_replica,
            length: Duration::from_secs(self.seconds),
            view_distance_m: self.view_distance,
            path: self.path,
            seed: self.seed,
            world_seed: self.world_seed,
            processors: self.processors.into(),
            is_shared: self.shared,
            delay: Duration::from_micros(self.delay_us),
            link_bytes_per_s: f64::from(self.link_mbit) * 1e6 / 8.0,
            costs,
        })
    }
}
