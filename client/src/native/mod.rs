//! The edge: everything that needs an operating system. Options, sockets and threads, files, the
//! window.

pub mod app;
pub mod args;
pub mod backoff;
pub mod plant_args;
pub mod relief_args;
pub mod shot;
pub mod stream;
pub mod textures;

use args::Args;

/// Runs the program that the options describe. The error is one line for a person.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let started = std::time::Instant::now();
    if args.shot.is_some() { shot::run(args, started) } else { app::run(args, started) }
}
