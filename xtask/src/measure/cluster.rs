//! `cluster`: two replicas behind nginx, without containers. The rows and their bars are those of
//! `cargo xtask cluster --check`.

use super::run::Run;
use anyhow::Result;
use bars::Bar;

/// Measures clusters.
///
/// # Errors
/// nginx is missing, or a process cannot be started.
pub fn rows(run: &mut Run) -> Result<Vec<Bar>> {
    run.notes.push(
        "Servers, nginx and the load on the same cores, over the loopback. Gaps are from the last chunk or \
         complete view of a lost session to the first of the next."
            .into(),
    );
    crate::cluster::rows()
}
