//! The GPU device: adapter selection, opening, fault recording.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Environment variable with a part of the name of the GPU to use, in any case. The best one of all
/// is used without it, or if it is empty.
pub const ADAPTER_NAME: &str = "WGPU_ADAPTER_NAME";

/// An open GPU.
#[derive(Debug)]
pub struct Gpu {
    /// Kept to recreate surfaces.
    pub instance: wgpu::Instance,
    /// The adapter.
    pub adapter: wgpu::Adapter,
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    faults: Arc<Mutex<Faults>>,
}

/// What went wrong since the device was opened.
#[derive(Debug, Default)]
struct Faults {
    /// The first fault: later ones are its consequences.
    first: Option<String>,
    /// Why the device cannot be used any more: it was lost, or its memory is exhausted.
    loss: Option<String>,
}

impl Faults {
    fn note(&mut self, fault: &str, is_loss: bool) {
        let line = one_line(fault);
        if is_loss {
            self.loss.get_or_insert_with(|| line.clone());
        }
        self.first.get_or_insert(line);
    }
}

/// A GPU error.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// No adapter was found.
    #[error(
        "no GPU adapter found ({0}): install a Vulkan driver, on Debian or Ubuntu `apt install \
         mesa-vulkan-drivers libvulkan1`"
    )]
    NoAdapter(String),
    /// No adapter has the name that [`ADAPTER_NAME`] asks for.
    #[error(
        "no GPU has `{wanted}` in its name; usable here: {known}; set {ADAPTER_NAME} to a part of one of \
         these names, or unset it"
    )]
    NoSuchAdapter {
        /// The value of the variable.
        wanted: String,
        /// Names of the adapters.
        known: String,
    },
    /// The adapter lacks what portable WebGPU guarantees.
    #[error(
        "the GPU `{adapter}` cannot be used ({cause}): update its driver or choose another with \
         {ADAPTER_NAME}"
    )]
    NoDevice {
        /// Its name.
        adapter: String,
        /// The driver's message.
        cause: String,
    },
    /// The device failed while drawing.
    #[error("the GPU failed: {0}")]
    Fault(String),
    /// The device was lost or ran out of memory more often than it is replaced.
    #[error(
        "the GPU failed and was opened again {attempts} times, the last failure: {cause}; lower --chunk-mb \
         or --size, or choose another GPU with {ADAPTER_NAME}"
    )]
    LostAgain {
        /// Devices that were opened in place of failed ones.
        attempts: u32,
        /// The driver's message.
        cause: String,
    },
}

/// An instance, before there is a device.
pub fn instance(display: Option<Box<dyn wgpu::wgt::WgpuHasDisplayHandle>>) -> wgpu::Instance {
    let mut descriptor = match display {
        Some(display) => wgpu::InstanceDescriptor::new_with_display_handle_from_env(display),
        None => wgpu::InstanceDescriptor::new_without_display_handle_from_env(),
    };
    if cfg!(debug_assertions) {
        // Finds native-only usage in development instead of in a browser.
        descriptor.flags |= wgpu::InstanceFlags::STRICT_WEBGPU_COMPLIANCE;
    }
    wgpu::Instance::new(descriptor)
}

impl Gpu {
    /// Opens the best adapter that can present to `surface`; without a surface the best of all.
    /// With [`ADAPTER_NAME`] only adapters of that name count.
    ///
    /// # Errors
    /// There is no adapter, or its driver refuses.
    pub async fn open(
        instance: wgpu::Instance,
        surface: Option<&wgpu::Surface<'_>>,
    ) -> Result<Self, GpuError> {
        Self::open_with(instance, surface, wgpu::Features::empty()).await
    }

    /// [`Gpu::open`] with optional features for measurements; unsupported ones are left out.
    ///
    /// # Errors
    /// As [`Gpu::open`].
    pub async fn open_with(
        instance: wgpu::Instance,
        surface: Option<&wgpu::Surface<'_>>,
        optional: wgpu::Features,
    ) -> Result<Self, GpuError> {
        let adapter = match std::env::var(ADAPTER_NAME) {
            Ok(wanted) if !wanted.is_empty() => named_adapter(&instance, surface, wanted).await?,
            _ => best_adapter(&instance, surface).await?,
        };
        Self::of_adapter(instance, adapter, optional).await
    }

    /// Opens an adapter of an instance, as [`Gpu::open_with`].
    ///
    /// # Errors
    /// Its driver refuses.
    pub async fn of_adapter(
        instance: wgpu::Instance,
        adapter: wgpu::Adapter,
        optional: wgpu::Features,
    ) -> Result<Self, GpuError> {
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("tombolo"),
            required_features: adapter.features() & optional,
            ..Default::default()
        };
        let (device, queue) = adapter.request_device(&descriptor).await.map_err(|error| {
            GpuError::NoDevice { adapter: adapter.get_info().name, cause: one_line(&error.to_string()) }
        })?;

        let faults = Arc::new(Mutex::new(Faults::default()));
        let note = |faults: &Arc<Mutex<Faults>>| {
            let faults = Arc::clone(faults);
            move |fault: &str, is_loss: bool| {
                faults.lock().unwrap_or_else(PoisonError::into_inner).note(fault, is_loss);
            }
        };
        let uncaptured = note(&faults);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            // After a failed allocation some resource is invalid, and with it all that uses it.
            uncaptured(&error.to_string(), matches!(error, wgpu::Error::OutOfMemory { .. }));
        }));
        let lost = note(&faults);
        // Also of a device that is dropped, whose faults are not read.
        device.set_device_lost_callback(move |reason, message| {
            lost(&format!("the device was lost ({reason:?}) {message}"), true);
        });
        Ok(Self { instance, adapter, device, queue, faults })
    }

    /// Opens the best adapter, without a window. Blocks.
    ///
    /// # Errors
    /// There is no adapter, or its driver refuses.
    pub fn open_blocking() -> Result<Self, GpuError> {
        pollster::block_on(Self::open(instance(None), None))
    }

    /// Opens a new device in place of one that was lost: of the same adapter, or else of the best
    /// one that can present to `surface`.
    ///
    /// # Errors
    /// There is no adapter, or its driver refuses.
    pub async fn reopen(&self, surface: Option<&wgpu::Surface<'_>>) -> Result<Self, GpuError> {
        let (instance, features) = (self.instance.clone(), self.device.features());
        match Self::of_adapter(instance.clone(), self.adapter.clone(), features).await {
            Ok(gpu) => Ok(gpu),
            Err(_) => Self::open_with(instance, surface, features).await,
        }
    }

    /// Why the device cannot be used any more; none while it can.
    #[must_use]
    pub fn loss(&self) -> Option<String> {
        // A loss is reported by a poll.
        let _ = self.device.poll(wgpu::PollType::Poll);
        self.faults().loss.clone()
    }

    fn faults(&self) -> MutexGuard<'_, Faults> {
        self.faults.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether the driver draws on the CPU.
    #[must_use]
    pub fn is_software(&self) -> bool {
        self.adapter.get_info().device_type == wgpu::DeviceType::Cpu
    }

    /// Name and backend of the adapter, for display.
    #[must_use]
    pub fn name(&self) -> String {
        let info = self.adapter.get_info();
        format!("{} ({})", info.name, info.backend)
    }

    /// Fails with the first fault since the device was opened: later results are invalid.
    ///
    /// # Errors
    /// That fault.
    pub fn check(&self) -> Result<(), GpuError> {
        // Losses are reported by polls.
        let _ = self.device.poll(wgpu::PollType::Poll);
        match &self.faults().first {
            Some(fault) => Err(GpuError::Fault(fault.clone())),
            None => Ok(()),
        }
    }

    /// Blocks until everything submitted is done.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.device
            .poll(wgpu::PollType::wait_indefinitely())
            .map_err(|error| GpuError::Fault(error.to_string()))?;
        self.check()
    }
}

async fn best_adapter(
    instance: &wgpu::Instance,
    surface: Option<&wgpu::Surface<'_>>,
) -> Result<wgpu::Adapter, GpuError> {
    let options = wgpu::RequestAdapterOptions {
        power_preference: wgpu::PowerPreference::HighPerformance,
        compatible_surface: surface,
        ..Default::default()
    };
    let found = instance.request_adapter(&options).await;
    found.map_err(|error| GpuError::NoAdapter(one_line(&error.to_string())))
}

/// The first adapter of a name. Not by wgpu's own function, which panics if there is none.
async fn named_adapter(
    instance: &wgpu::Instance,
    surface: Option<&wgpu::Surface<'_>>,
    wanted: String,
) -> Result<wgpu::Adapter, GpuError> {
    let mut adapters = instance.enumerate_adapters(wgpu::Backends::all()).await;
    adapters.retain(|adapter| surface.is_none_or(|surface| adapter.is_surface_supported(surface)));
    let names: Vec<String> = adapters.iter().map(|adapter| adapter.get_info().name).collect();
    match position_of(&wanted, &names) {
        Some(index) => Ok(adapters.swap_remove(index)),
        None if names.is_empty() => Err(GpuError::NoSuchAdapter { wanted, known: "none".into() }),
        None => Err(GpuError::NoSuchAdapter { wanted, known: names.join(", ") }),
    }
}

/// The first of some names that contains a text, in any case.
fn position_of(wanted: &str, names: &[String]) -> Option<usize> {
    let wanted = wanted.to_lowercase();
    names.iter().position(|name| name.to_lowercase().contains(&wanted))
}

/// The first four lines of a driver's message as one.
fn one_line(text: &str) -> String {
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && *line != "Caused by:");
    lines.take(4).collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_adapter_is_found_by_a_part_of_its_name_in_any_case() {
        let names = ["NVIDIA H200", "llvmpipe (LLVM 15.0.6)", "llvmpipe"].map(String::from);
        assert_eq!(position_of("LLVMpipe", &names), Some(1));
        assert_eq!(position_of("h200", &names), Some(0));
        assert_eq!(position_of("radv", &names), None);
    }

    #[test]
    fn an_error_without_a_match_lists_the_names() {
        let instance = instance(None);
        let found = pollster::block_on(named_adapter(&instance, None, "no such GPU".into()));
        let error = found.unwrap_err().to_string();
        assert!(error.contains("`no such GPU`") && error.contains(ADAPTER_NAME), "{error}");
        let known = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
        assert!(known.iter().all(|adapter| error.contains(&adapter.get_info().name)), "{error}");
    }

    #[test]
    fn a_loss_is_known_whatever_fault_came_first() {
        let mut faults = Faults::default();
        faults.note("a buffer is invalid", false);
        assert_eq!(faults.loss, None, "a validation error is no loss");
        faults.note("Out of Memory", true);
        faults.note("later", true);
        assert_eq!(faults.first.as_deref(), Some("a buffer is invalid"));
        assert_eq!(faults.loss.as_deref(), Some("Out of Memory"));
    }
}
