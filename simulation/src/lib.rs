//! Sessions in virtual time: [`protocol::client::ClientSession`] and
//! [`protocol::server::ServerSession`] exchange real frames over a modelled network with a modelled
//! server, whose work takes measured times. A second of a million sessions needs no million
//! sockets.
//!
//! | module | what it is |
//! | --- | --- |
//! | [`config`] | options |
//! | [`costs`] | times of the server's work, and their measurement |
//! | [`frames`] | frames of chunks, made once for all replicas |
//! | [`client`] | one client: path, views, probes, its session |
//! | [`processors`] | the processors of a replica: which work comes next |
//! | [`generation`] | the queue of generation: flows in turns, one job a key |
//! | [`replica`] | one replica with its clients: the loop of events |
//! | [`report`] | what came of it |
//!
//! What is not modelled: loss of packets, pauses of the system, eviction from caches, errors of
//! chunks that a server measures once for the selection of views, tiles and pages.

#![forbid(unsafe_code)]

pub mod client;
pub mod config;
pub mod costs;
pub mod frames;
pub mod generation;
pub mod processors;
pub mod replica;
pub mod report;

use config::Plan;
use frames::Frames;
use rayon::prelude::*;
use report::Report;
use terrain::Land;

/// Simulates a plan: its replicas beside each other on all processors of this machine. The same
/// plan has the same report.
#[must_use]
pub fn run(plan: &Plan) -> Report {
    let land = Land::new(plan.world_seed);
    let (frames, start) = (Frames::new(land), land.start());
    let replicas: Vec<Report> = (0..plan.replicas())
        .into_par_iter()
        .map(|number| replica::Replica::new(plan, &frames, start, number).run())
        .collect();
    replicas.iter().fold(Report::default(), Report::and)
}

#[cfg(test)]
mod tests;
