//! Tasks run exactly once, whatever the threads do. A call that hangs is ended by the program that runs the tests.

use std::sync::atomic::AtomicUsize;

use super::*;

#[test]
fn every_task_runs_exactly_once_in_every_call() {
    for size in 1..=4 {
        let team = Team::new(size).expect("threads");
        for round in 0..2000 {
            let mut tasks = vec![0_usize; round % 9];
            team.for_each(&mut tasks, |task| *task += round + 1);
            assert!(tasks.iter().all(|task| *task == round + 1), "{size} threads: {tasks:?}");
        }
    }
}

#[test]
fn workers_that_are_parked_wake_up_and_help() {
    let team = Team::new(2).expect("threads");
    for _ in 0..5 {
        while !team.shared.parked[0].load(Ordering::SeqCst) {
            thread::yield_now();
        }
        let started = [const { AtomicBool::new(false) }; 2];
        // Each task waits for the other: one thread alone would never finish the first.
        team.for_each(&mut [0, 1], |task| {
            started[*task].store(true, Ordering::SeqCst);
            while !started[1 - *task].load(Ordering::SeqCst) {
                thread::yield_now();
            }
        });
    }
}

#[test]
fn a_call_returns_only_after_the_tasks_that_workers_have_taken() {
    let team = Team::new(2).expect("threads");
    let caller = thread::current().id();
    let started = [const { AtomicBool::new(false) }; 2];
    let mut tasks = [(0, false), (1, false)];
    team.for_each(&mut tasks, |(task, finished)| {
        started[*task].store(true, Ordering::SeqCst);
        while !started[1 - *task].load(Ordering::SeqCst) {
            thread::yield_now();
        }
        if thread::current().id() != caller {
            thread::sleep(20 * POLLING);
        }
        *finished = true;
    });
    assert_eq!(tasks, [(0, true), (1, true)]);
}

#[test]
fn a_panic_in_a_task_reaches_the_caller_after_all_other_tasks_and_the_team_works_on() {
    let team = Team::new(3).expect("threads");
    for panicking in 0..8 {
        let finished = AtomicUsize::new(0);
        let mut tasks: Vec<usize> = (0..8).collect();
        let outcome = catch_unwind(AssertUnwindSafe(|| {
            team.for_each(&mut tasks, |task| {
                if *task == panicking {
                    resume_unwind(Box::new("a panic without a message"));
                }
                finished.fetch_add(1, Ordering::SeqCst);
            });
        }));
        assert!(outcome.is_err());
        assert_eq!(finished.into_inner(), 7);
        let mut tasks = [1; 5];
        team.for_each(&mut tasks, |task| *task += 1);
        assert_eq!(tasks, [2; 5]);
    }
}

#[test]
fn calls_within_a_task_and_from_several_threads_run_their_tasks() {
    let team = Team::new(3).expect("threads");
    thread::scope(|scope| {
        for _ in 0..3 {
            scope.spawn(|| {
                for _ in 0..500 {
                    let mut outer = [[0; 4]; 3];
                    team.for_each(&mut outer, |inner| team.for_each(inner, |task| *task += 1));
                    assert_eq!(outer, [[1; 4]; 3]);
                }
            });
        }
    });
}

#[test]
fn workers_carry_names_and_end_with_the_team() {
    let team = Team::new(3).expect("threads");
    let names: Vec<_> = team.workers().iter().map(|worker| worker.thread().name().map(str::to_owned)).collect();
    assert_eq!(names, [Some("fw-net-1".to_owned()), Some("fw-net-2".to_owned())]);
    let shared = Arc::clone(&team.shared);
    drop(team);
    assert_eq!(Arc::strong_count(&shared), 1);
}
