//! `cluster`: two replicas behind nginx, without containers. The rows and their bars are those of
//! `cargo xtask cluster --check`.

use super::run::Run;
use anyhow::Result;
use bars::Bar;

/// Hours of clients that fly, with a fault every minute.
///
/// # Errors
/// As [`rows`].
pub fn soak(run: &mut Run) -> Result<Vec<Bar>> {
    run.notes.push(
        "Three replicas, nginx, an S3 store and 100 clients on the same cores, over the loopback; every \
         chunk is checked by its digest, one of 32 is generated again and compared."
            .into(),
    );
    crate::cluster::soak_rows()
}

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
