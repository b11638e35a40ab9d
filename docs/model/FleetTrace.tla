----------------------------- MODULE FleetTrace -----------------------------
(* Whether what was seen on real hosts is a behaviour of Fleet. Observed.tla, which is written from a run, defines
   Owners, the managers of the runs in the order in which they began, and Trace, a sequence of sets of events:
   what was seen at one look, in any order. *)
EXTENDS Fleet, Observed, Sequences

VARIABLES
  looks,  \* of Trace that were carried out
  done    \* events of the next one that were carried out

Events == Trace[looks + 1]

Carry(e) ==
  \/ e.kind = "grant" /\ \E heard \in BOOLEAN : Grant(e.run, e.host, heard)
  \/ e.kind = "start" /\ \E r \in Begun : plan[r][e.task].start = e.host /\ DeliverStart(r, e.task)
  \/ e.kind = "stop" /\ e.task \in living[e.host]
     /\ \E r \in Begun, heard \in BOOLEAN : plan[r][e.task].stop = e.host /\ DeliverStop(r, e.task, heard)

Observe ==
  /\ looks < Len(Trace)
  /\ \E e \in Events \ done :
       /\ Carry(e)
       /\ IF done \cup {e} = Events
          THEN looks' = looks + 1 /\ done' = {}
          ELSE looks' = looks /\ done' = done \cup {e}

(* What nobody could see. A lease ends only to let another run have the host, and a decision on a task is taken
   before something happens to it: other orders add nothing. *)
Wants(e, t) == e.kind \in {"start", "stop"} /\ e.task = t

Hidden ==
  /\ looks < Len(Trace)
  /\ \/ \E m \in Managers : Cardinality(Begun) < Len(Owners) /\ m = Owners[Cardinality(Begun) + 1] /\ Begin(m)
     \/ \E r \in Begun : Look(r) \/ End(r)
     \/ \E r \in Begun, t \in Tasks : (\E e \in Events : Wants(e, t)) /\ Decide(r, t)
     \/ \E h \in Hosts : (\E e \in Events : e.kind = "grant" /\ e.host = h) /\ LeaseEnds(h)
     \/ LeaderEnds
  /\ UNCHANGED <<looks, done>>

TraceInit == Init /\ looks = 0 /\ done = {}
TraceSpec == TraceInit /\ [][Observe \/ Hidden]_<<vars, looks, done>>

\* TLC reports this as violated where the whole trace is a behaviour, and finds no error where it is none.
NotAccepted == looks < Len(Trace)
=============================================================================
