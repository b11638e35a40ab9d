------------------------------- MODULE Fleet -------------------------------
(* Several managers of one fleet: lease, epoch, start, stop and move of tasks.
   README.md beside this file says what stands for what, and what is left out. *)
EXTENDS Naturals, FiniteSets, TLC

CONSTANTS
  Managers, Hosts, Tasks,
  None,
  Common,       \* a host that every run must hear before it acts; None: there is no such host
  UsesEtcd,     \* runs take a lease in etcd first, and share their book there
  ChecksLease,  \* hosts refuse requests of a run that does not have their lease
  HoldsUnseen,  \* a run holds what another manager may have placed on a silent host
  BooksFirst,   \* a run writes down where it starts a task before it sends the request
  ProvesStop,   \* a move starts the new instance only after the proof that the old one is gone
  WaitsAfterBoot, \* a host that booted grants nothing to another holder for one lease
  MaxRuns,      \* runs of edgectl, of all managers together
  MaxReboots

VARIABLES
  owner,    \* run -> its manager; runs are numbered in the order in which they begin
  stage,    \* run -> "none", "probing", "acting", "over"
  told,     \* run -> host -> tasks that it reported with its grant, or Unheard
  plan,     \* run -> task -> what was sent, see Idle, StartAt, StopAt, MoveFrom below
  session,  \* host -> run that was granted the fleet there last; 0: nobody
  lease,    \* host -> "none", "live", "waits": booted while the lease was in force
  news,     \* host -> managers that have not seen all hosts since another one was granted the fleet there
  living,   \* host -> tasks of which an instance lives
  placed,   \* book -> task -> hosts where it was started last, or is being started; durable
  leader,   \* run that has the lease of etcd; 0: none
  reboots

vars == <<owner, stage, told, plan, session, lease, news, living, placed, leader, reboots>>

Runs == 1..MaxRuns
\* All managers that share one etcd are one holder to the hosts, and have one book.
Holder(m) == IF UsesEtcd THEN "etcd" ELSE m
Books == {Holder(m) : m \in Managers}

Unheard == {None}
Idle == [stop |-> None, start |-> None, sent |-> FALSE]
Active(r) == stage[r] \in {"probing", "acting"}
Answered(r) == {h \in Hosts : told[r][h] # Unheard}
Silent(r) == Hosts \ Answered(r)
Begun == {r \in Runs : stage[r] # "none"}

Init ==
  /\ owner = [r \in Runs |-> None]
  /\ stage = [r \in Runs |-> "none"]
  /\ told = [r \in Runs |-> [h \in Hosts |-> Unheard]]
  /\ plan = [r \in Runs |-> [t \in Tasks |-> Idle]]
  /\ session = [h \in Hosts |-> 0]
  /\ lease = [h \in Hosts |-> "none"]
  /\ news = [h \in Hosts |-> {}]
  /\ living = [h \in Hosts |-> {}]
  /\ placed = [b \in Books |-> [t \in Tasks |-> {}]]
  /\ leader = 0
  /\ reboots = 0

(* What can never be carried out again is forgotten: fewer states, the same behaviours. Of a run that is over
   only requests to hosts that still obey it matter. *)
Obeys(h, r, sessions, leases) == ChecksLease => sessions[h] = r /\ leases[h] = "live"

Forget(plans, stages, sessions, leases) ==
  [r \in Runs |->
     IF stages[r] \in {"none", "probing", "acting"} THEN plans[r]
     ELSE [t \in Tasks |->
             LET p == plans[r][t]
                 stop == IF p.stop # None /\ Obeys(p.stop, r, sessions, leases) THEN p.stop ELSE None
                 start == IF p.start # None /\ p.sent /\ Obeys(p.start, r, sessions, leases) THEN p.start ELSE None
             IN [stop |-> stop, start |-> start, sent |-> start # None]]]

\* The run is over: it ended, was killed, or its lease is over by its own clock. It sends nothing more.
Over(r) == [stage EXCEPT ![r] = "over"]
Forgotten(r) == [told EXCEPT ![r] = [h \in Hosts |-> Unheard]]

\* --- a run of edgectl ---------------------------------------------------------------------------------------

\* One run at a time on each machine; with etcd one in the fleet, by the clock of etcd.
Begin(m) ==
  /\ Cardinality(Begun) < MaxRuns
  /\ \A r \in Begun : owner[r] = m => ~Active(r)
  /\ UsesEtcd => leader = 0
  /\ LET r == Cardinality(Begun) + 1 IN
     /\ owner' = [owner EXCEPT ![r] = m]
     /\ stage' = [stage EXCEPT ![r] = "probing"]
     /\ leader' = IF UsesEtcd THEN r ELSE 0
  /\ UNCHANGED <<told, plan, session, lease, news, living, placed, reboots>>

(* A host that gets the claim of a run grants the fleet: to the holder at once, to another one when the lease is
   over. A claim arrives at any time, also when its run is over, any number of times, or never; the same holds for
   the reply. *)
Grantable(h, r) ==
  IF session[h] = 0 \/ lease[h] = "none" \/ (~WaitsAfterBoot /\ lease[h] = "waits") THEN TRUE
  ELSE Holder(owner[session[h]]) = Holder(owner[r])

Grant(r, h, heard) ==
  /\ r \in Begun /\ Grantable(h, r)
  /\ UsesEtcd => r >= session[h]     \* a claim with an older revision of etcd is refused
  /\ heard => stage[r] = "probing"
  /\ ~heard => session[h] # r \/ lease[h] # "live"   \* else nothing changes
  /\ session' = [session EXCEPT ![h] = r]
  /\ lease' = [lease EXCEPT ![h] = "live"]
  /\ news' = [news EXCEPT ![h] = IF UsesEtcd THEN {} ELSE @ \cup (Managers \ {owner[r]})]
  /\ told' = IF heard THEN [told EXCEPT ![r][h] = living[h]] ELSE told
  /\ plan' = Forget(plan, stage, session', lease')
  /\ UNCHANGED <<owner, stage, living, placed, leader, reboots>>

(* Silent hosts are given up. The book now says what the run knows: what lives on hosts that answered, and what it
   said before of those that did not. *)
Copies(r, t) == {h \in Answered(r) : t \in told[r][h]}

Look(r) ==
  /\ stage[r] = "probing" /\ Answered(r) # {}
  /\ Common # None => Common \in Answered(r)
  /\ stage' = [stage EXCEPT ![r] = "acting"]
  /\ placed' = [placed EXCEPT ![Holder(owner[r])] =
                  [t \in Tasks |-> (@[t] \cap Silent(r)) \cup Copies(r, t)]]
  /\ news' = IF Silent(r) = {} THEN [h \in Hosts |-> news[h] \ {owner[r]}] ELSE news
  /\ UNCHANGED <<owner, told, plan, session, lease, living, leader, reboots>>

MayBeUnseen(r) == HoldsUnseen /\ Silent(r) # {} /\ \E h \in Answered(r) : owner[r] \in news[h]
Held(r, t) == placed[Holder(owner[r])][t] \cap Silent(r) # {} \/ MayBeUnseen(r)

\* Where a task may be moved that runs: nowhere while it may run on a silent host, too.
Destinations(r, t) ==
  IF Cardinality(Copies(r, t)) = 1 /\ placed[Holder(owner[r])][t] \cap Silent(r) = {}
  THEN Answered(r) \ Copies(r, t) ELSE {}

\* What runs nowhere is started, unless it may run on a silent host; what runs is moved or stopped.
Decide(r, t) ==
  /\ stage[r] = "acting" /\ plan[r][t] = Idle
  /\ \/ /\ Copies(r, t) = {} /\ ~Held(r, t)
        /\ \E h \in Answered(r) :
             /\ plan' = [plan EXCEPT ![r][t] = [stop |-> None, start |-> h, sent |-> TRUE]]
             /\ placed' = IF BooksFirst THEN [placed EXCEPT ![Holder(owner[r])][t] = @ \cup {h}] ELSE placed
     \/ \E old \in Copies(r, t), new \in Destinations(r, t) \cup {None} :
        /\ plan' = [plan EXCEPT ![r][t] = [stop |-> old, start |-> new, sent |-> new # None /\ ~ProvesStop]]
        /\ placed' = IF BooksFirst /\ new # None
                     THEN [placed EXCEPT ![Holder(owner[r])][t] = @ \cup {new}] ELSE placed
  /\ UNCHANGED <<owner, stage, told, session, lease, news, living, leader, reboots>>

End(r) ==
  /\ Active(r)
  /\ stage' = Over(r) /\ told' = Forgotten(r)
  /\ plan' = Forget(plan, stage', session, lease)
  /\ UNCHANGED <<owner, session, lease, news, living, placed, leader, reboots>>

\* --- requests and hosts ---------------------------------------------------------------------------------------

DeliverStart(r, t) ==
  LET p == plan[r][t] IN
  /\ p.start # None /\ p.sent /\ Obeys(p.start, r, session, lease)
  /\ t \notin living[p.start]
  /\ living' = [living EXCEPT ![p.start] = @ \cup {t}]
  /\ UNCHANGED <<owner, stage, told, plan, session, lease, news, placed, leader, reboots>>

\* ``heard``: the manager gets the proof that nothing is left, notes it in its book, and sends the start of a move.
DeliverStop(r, t, heard) ==
  LET p == plan[r][t] IN
  /\ p.stop # None /\ Obeys(p.stop, r, session, lease)
  /\ living' = [living EXCEPT ![p.stop] = @ \ {t}]
  /\ IF heard
     THEN /\ stage[r] = "acting" /\ ~p.sent
          /\ placed' = [placed EXCEPT ![Holder(owner[r])][t] = @ \ {p.stop}]
          /\ plan' = [plan EXCEPT ![r][t].sent = p.start # None]
     ELSE t \in living[p.stop] /\ UNCHANGED <<plan, placed>>
  /\ UNCHANGED <<owner, stage, told, session, lease, news, leader, reboots>>

Reboot(h) ==
  /\ reboots < MaxReboots
  /\ reboots' = reboots + 1
  /\ living' = [living EXCEPT ![h] = {}]
  /\ lease' = [lease EXCEPT ![h] = IF @ = "live" THEN "waits" ELSE @]
  /\ plan' = Forget(plan, stage, session, lease')
  /\ UNCHANGED <<owner, stage, told, session, news, placed, leader>>

\* --- time -----------------------------------------------------------------------------------------------------

(* A manager counts from before its request left, so every lease that a host granted before is over by the clocks of
   the managers when that of the host ends. A run whose lease is over on one host that answered sends nothing more to
   any host. *)
LeaseEnds(h) ==
  /\ lease[h] # "none"
  /\ lease' = [lease EXCEPT ![h] = "none"]
  /\ LET ends == {r \in Runs : Active(r) /\ told[r][h] # Unheard} IN
     /\ stage' = [r \in Runs |-> IF r \in ends THEN "over" ELSE stage[r]]
     /\ told' = [r \in Runs |-> IF r \in ends THEN [each \in Hosts |-> Unheard] ELSE told[r]]
  /\ plan' = Forget(plan, stage', session, lease')
  /\ UNCHANGED <<owner, session, news, living, placed, leader, reboots>>

LeaderEnds ==
  /\ leader # 0
  /\ leader' = 0
  /\ stage' = IF Active(leader) THEN Over(leader) ELSE stage
  /\ told' = Forgotten(leader)
  /\ plan' = Forget(plan, stage', session, lease)
  /\ UNCHANGED <<owner, session, lease, news, living, placed, reboots>>

Next ==
  \/ \E m \in Managers : Begin(m)
  \/ \E r \in Begun : Look(r) \/ End(r)
  \/ \E r \in Begun, h \in Hosts, heard \in BOOLEAN : Grant(r, h, heard)
  \/ \E r \in Begun, t \in Tasks : Decide(r, t) \/ DeliverStart(r, t)
  \/ \E r \in Begun, t \in Tasks, heard \in BOOLEAN : DeliverStop(r, t, heard)
  \/ \E h \in Hosts : Reboot(h) \/ LeaseEnds(h)
  \/ LeaderEnds

Spec == Init /\ [][Next]_vars

\* --- what must hold -------------------------------------------------------------------------------------------

NeverTwice == \A t \in Tasks : Cardinality({h \in Hosts : t \in living[h]}) <= 1

\* No two runs have sent, or may send, to the same host.
OneWriter == \A h \in Hosts : Cardinality({r \in Runs : stage[r] = "acting" /\ told[r][h] # Unheard}) <= 1

\* What a run saw on a host stays true while it may act, but for what it does itself and for a reboot.
NothingUnseen ==
  \A r \in Runs, h \in Hosts, t \in Tasks :
    stage[r] = "acting" /\ told[r][h] # Unheard /\ t \in living[h] => t \in told[r][h] \/ plan[r][t].start = h

Alike == Permutations(Managers) \cup Permutations(Tasks) \cup Permutations(Hosts \ {Common})
=============================================================================
