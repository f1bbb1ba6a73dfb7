//! Culling judged: what is left out although it is seen, what is kept although it is hidden, and what either costs.

pub mod oracle;
pub mod poses;
