//! Places for connections.
//!
//! Whoever has shown no right to anything makes room for new connections, and then whoever may only look, so that many slow
//! clients, or somebody with a stolen link to look, cannot keep an operator from letting go of the servos.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use tokio::sync::Notify;

use crate::access::Role;

/// The open connections, the oldest first.
#[derive(Debug, Default, Clone)]
pub struct Places(Arc<Mutex<VecDeque<Arc<Connection>>>>);

#[derive(Debug, Default)]
struct Connection {
    /// The role in which the last request came.
    role: Mutex<Option<Role>>,
    end: Notify,
}

/// The place of one connection, until it is dropped.
#[derive(Debug)]
pub struct Place(Arc<Connection>, Places);

impl Places {
    fn open(&self) -> MutexGuard<'_, VecDeque<Arc<Connection>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a place. If `most` are taken, the oldest connection with the least rights loses its own. `None` if all belong to
    /// operators.
    pub fn enter(&self, most: usize) -> Option<Place> {
        let mut open = self.open();
        if open.len() >= most {
            let least =
                (0..open.len()).min_by_key(|index| open.get(*index).and_then(|connection| connection.role()))?;
            let least = open.get(least).filter(|connection| connection.role() < Some(Role::Operate)).cloned()?;
            least.end.notify_one();
            open.retain(|connection| !Arc::ptr_eq(connection, &least));
        }
        let connection = Arc::<Connection>::default();
        open.push_back(Arc::clone(&connection));
        Some(Place(connection, self.clone()))
    }
}

impl Connection {
    fn role(&self) -> Option<Role> {
        *self.role.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Place {
    /// Notes the role in which a request came.
    pub fn set_role(&self, role: Option<Role>) {
        *self.0.role.lock().unwrap_or_else(PoisonError::into_inner) = role;
    }

    /// Waits until the connection must make room for another one.
    pub async fn lost(&self) {
        self.0.end.notified().await;
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.1.open().retain(|connection| !Arc::ptr_eq(connection, &self.0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_of_the_least_role_makes_room_and_no_operator_does() {
        let places = Places::default();
        let enter = || places.enter(3).unwrap();
        let (operator, looker, stranger) = (enter(), enter(), enter());
        operator.set_role(Some(Role::Operate));
        looker.set_role(Some(Role::Look));
        let is_open = |place: &Place| places.open().iter().any(|connection| Arc::ptr_eq(connection, &place.0));
        let second = enter();
        assert!(is_open(&operator) && is_open(&looker) && !is_open(&stranger));
        second.set_role(Some(Role::Operate));
        let third = enter();
        assert!(is_open(&second) && is_open(&third) && !is_open(&looker));
        third.set_role(Some(Role::Operate));
        assert!(places.enter(3).is_none());
        drop(operator);
        assert!(places.enter(3).is_some());
    }
}
